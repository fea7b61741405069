"""CFAR detection on power maps of any rank.

Every detector estimates the noise around each cell under test from training
cells in a window, and multiplies it with a factor of `isacbench.dsp.cfar.factors`.

| detector | noise estimate |
|---|---|
| `ca_cfar` | mean of the training cells |
| `goca_cfar`, `soca_cfar` | greater, smaller mean of the two halves of the window |
| `os_cfar` | order statistic of the training cells; `os_mask` is its mask alone |
| `osca_cfar` | order statistic along one axis, averaged over the others |
| `tm_cfar` | mean without the smallest and the largest training cells |

Windows: along an axis the window reaches `training + guard` cells to either
side of the cell under test. Near an edge it keeps its size and shifts to stay
inside the map, while the guard cells stay around the cell under test; each
cell gets the exact factor for the training cells it then has. Nothing is
padded. Training 0 and guard 0 along an axis treat its positions as
independent maps.

Powers: every finite float64 that is not negative, subnormal numbers and the
largest included. Noise is right to some 1e-14 of itself (or to the smallest
float64) whatever lies beside a cell, and a threshold is the largest float64
not above factor times noise where that is no float64, so that masks do not
depend on the unit of the map (`isacbench.dsp.cfar.map_scaling`).

A detector of one's own returns a `Detection`, checks its map by `checked_power`, and finds factors
in `isacbench.dsp.cfar.factors`.

Cells under test: all of the map, or those of the list `cells`, with the same
values to the last bit at a cost that follows the list.
"""

from __future__ import annotations

from isacbench.dsp.cfar.cell_averaging import ca_cfar, goca_cfar, soca_cfar
from isacbench.dsp.cfar.factors import check_looks, check_pfa
from isacbench.dsp.cfar.map_checks import (
    Cells,
    CellsPerSide,
    Threshold,
    check_cells,
    check_fraction,
    check_threshold,
    checked_axis,
    checked_power,
)
from isacbench.dsp.cfar.order_statistic import os_cfar, os_mask
from isacbench.dsp.cfar.sorted_means import check_trim, osca_cfar, tm_cfar
from isacbench.dsp.detection import Detection, Detector

__all__ = [
    "Cells",
    "CellsPerSide",
    "Detection",
    "Detector",
    "Threshold",
    "ca_cfar",
    "check_cells",
    "check_fraction",
    "check_looks",
    "check_pfa",
    "check_threshold",
    "check_trim",
    "checked_axis",
    "checked_power",
    "factors",
    "goca_cfar",
    "os_cfar",
    "os_mask",
    "osca_cfar",
    "soca_cfar",
    "tm_cfar",
]
