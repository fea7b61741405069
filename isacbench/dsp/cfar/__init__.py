"""CFAR detection on power maps of any rank: checks, windows, and factors of false-alarm rates.

`isacbench_algorithms.detectors` has the built-in detectors. To write your own: return a `Detection`, check
the map with `checked_power`, and take factors from `isacbench.dsp.cfar.factors`.
"""

from __future__ import annotations

from isacbench.dsp.cfar.training_cells import checked_power, windows_of
from isacbench.dsp.detection import Detection, Detector

__all__ = [
    "Detection",
    "Detector",
    "checked_power",
    "detection_rates",
    "factors",
    "training_cells",
    "trimmed_factors",
    "windows_of",
]
