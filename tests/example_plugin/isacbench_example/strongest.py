"""The strongest cell's beam: one point an image."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from isacbench.errors import require
from isacbench.model.cloud import PointCloud
from isacbench.model.observation import Observation
from isacbench.plugins.contracts import Detector

from .median import MedianCfar

__all__ = ["Strongest"]


@dataclass(frozen=True)
class Strongest:
    """Strongest detected range-Doppler cell, and the maximum of its angular spectrum.

    Attributes
    ----------
    detector : Detector
        Of range-Doppler cells.
    angle_points : int
        Samples of the spectrum along each direction cosine.

    Raises
    ------
    InputError
        If a parameter is out of range.
    """

    name: ClassVar[str] = "strongest"

    detector: Detector = field(default_factory=MedianCfar)
    angle_points: int = 256

    def __post_init__(self) -> None:
        require(self.angle_points >= 8, "angle_points", self.angle_points, "8 and more")

    def estimate(self, observation: Observation) -> PointCloud:
        """Image one observation."""
        cells, gate = observation.cells, observation.gate
        power = np.mean(np.abs(cells) ** 2, axis=(2, 3))
        found = self.detector.detect(power, looks=cells.shape[2] * cells.shape[3]).mask & gate.reachable
        if not found.any():
            return PointCloud.empty()
        row, column = np.unravel_index(np.where(found, power, 0).argmax(), power.shape)
        n = max(self.angle_points, *cells.shape[2:])
        beams = np.fft.ifft2(cells[row, column], (n, n), norm="forward")
        i, j = np.unravel_index(np.abs(beams).argmax(), beams.shape)
        cosine = 2 * np.fft.fftfreq(n)
        return observation.cloud(
            [gate.range_bins[row]],
            [gate.doppler_bins[column]],
            [cosine[i]],
            [cosine[j]],
            [power[row, column] / observation.system.processing_gain],
        )
