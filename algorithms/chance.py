"""References without skill: points spread at random over the truth's bounding box, and no point at all.

Weather forecasts are judged against climatology. Likewise, a score near that of `chance` proves nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isacbench.model.cloud import PointCloud
from isacbench.model.radio_coordinates import Radio
from isacbench.model.scenes.raw_uniforms import raw_uniforms

from .bases.references import N_REALISATIONS, Reference
from .oracle import Oracle

NUMBERING = Oracle(cell=0.5)
"""Reference with as many points, on average."""


@dataclass(frozen=True)
class Chance(Reference):
    """Zero skill: random points in the truth's bounding box, as many as `oracle[cell=0.5]` has.

    A single scatterer has no box: its point is anywhere in the region.
    """

    name: ClassVar[str] = "chance"

    def realisations(self, radio: Radio, truth: PointCloud) -> list[PointCloud]:
        """Spread points over the truth's box 64 times, the same on every machine.

        Parameters
        ----------
        radio : Radio
            Scenario or observation.

        Returns
        -------
        list of PointCloud
            Points uniform in x, y, z and v between the least and the largest of the truth, or in the
            region if the truth is at one place. They share the truth's power equally.
        """
        if not len(truth):
            return [PointCloud.empty()] * N_REALISATIONS
        n_points = round(np.mean([len(cloud) for cloud in NUMBERING.realisations(radio, truth)]))
        values = truth.to_array()[:, :4]
        lowest, highest = values.min(axis=0), values.max(axis=0)
        if (lowest == highest).all():
            region = radio.region
            lowest, highest = np.array([region.x_m, region.y_m, region.z_m, region.speed_mps]).T
        power = np.full(n_points, truth.power.sum() / n_points)
        clouds = []
        for number in range(N_REALISATIONS):
            shares = raw_uniforms(f"chance {number}", 4 * n_points).reshape(n_points, 4)
            # Rounding may exceed an end by its last digit.
            drawn = np.clip(lowest + shares * (highest - lowest), lowest, highest)
            clouds.append(PointCloud(drawn[:, :3], drawn[:, 3], power))
        return clouds


@dataclass(frozen=True)
class Empty(Reference):
    """Zero effort: an image without points."""

    name: ClassVar[str] = "empty"

    def realisations(self, radio: Radio, truth: PointCloud) -> list[PointCloud]:
        """Make an image without points.

        Parameters
        ----------
        radio : Radio
            Scenario or observation.

        Returns
        -------
        list of PointCloud
            One.
        """
        return [PointCloud.empty()]
