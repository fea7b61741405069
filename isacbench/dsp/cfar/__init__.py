"""CFAR detection on power maps of any rank: checks, windows, and factors of false-alarm rates.

`isacbench_algorithms.detectors` has the built-in detectors. To write your own: return a `Detection`, check
the map with `checked_power`, and take factors from `isacbench.dsp.cfar.factors`.
"""

from __future__ import annotations

from isacbench.dsp.cfar.factors import check_looks, check_pfa
from isacbench.dsp.cfar.map_checks import (
    Cells,
    CellsPerSide,
    Threshold,
    check_cells,
    check_fraction,
    check_threshold,
    checked_axis,
    checked_list,
    checked_power,
    share_of,
    spread,
)
from isacbench.dsp.cfar.training_cells import Axis, Windows, window_axes, windows_of
from isacbench.dsp.detection import Detection, Detector

__all__ = [
    "Axis",
    "Cells",
    "CellsPerSide",
    "Detection",
    "Detector",
    "Threshold",
    "Windows",
    "check_cells",
    "check_fraction",
    "check_looks",
    "check_pfa",
    "check_threshold",
    "checked_axis",
    "checked_list",
    "checked_power",
    "detection_rates",
    "factors",
    "share_of",
    "spread",
    "window_axes",
    "windows_of",
]
