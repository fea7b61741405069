"""CFAR detection on power maps of any rank: detectors, their windows and their factors.

To write your own detector: return a `Detection`, check the map with `checked_power`, and take factors
from `isacbench.dsp.cfar.factors`.
"""

from __future__ import annotations

from isacbench.dsp.cfar.cfar_detectors import CaCfar, GocaCfar, OscaCfar, OsCfar, SocaCfar, TmCfar
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
from isacbench.dsp.detection import Detection, Detector

__all__ = [
    "CaCfar",
    "Cells",
    "CellsPerSide",
    "Detection",
    "Detector",
    "GocaCfar",
    "OsCfar",
    "OscaCfar",
    "SocaCfar",
    "Threshold",
    "TmCfar",
    "check_cells",
    "check_fraction",
    "check_looks",
    "check_pfa",
    "check_threshold",
    "checked_axis",
    "checked_power",
    "factors",
]
