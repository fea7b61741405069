"""References: estimators that see the truth and give many realisations of what they make of it.

`oracle` is a limit of resolution: the truth merged in the radio's own Rayleigh cells, a range bin, a
velocity bin, and 2/P and 2/Q in direction cosine (2/16 on the 16 x 16 array). The number of merged
scatterers depends on where the borders of the cells lie. The lattice of cells is therefore moved by 64
fixed offsets, and scores are means over the 64 clouds.

`chance` and `empty` are without skill: points spread at random over the truth's bounding box, and no point
at all. Weather forecasts are judged against climatology. Likewise, a score near that of `chance` proves
nothing.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isacbench.checked_arrays import Floats
from isacbench.cores import one_blas_thread
from isacbench.errors import InputError, require
from isacbench.metrics.realisations import nearest_to_mean
from isacbench.model.cloud import PointCloud
from isacbench.model.observation import Observation
from isacbench.model.radio_coordinates import Radio, radio_places, rayleigh_cells
from isacbench.model.scenes.raw_uniforms import raw_uniforms
from isacbench.plugins.contracts import Needs

N_REALISATIONS = 64
"""Realisations of each reference: the standard error of a mean is an eighth of the spread or less."""


class Reference(ABC):
    """Estimator whose scores are means over realisations."""

    name: ClassVar[str]
    needs_truth: ClassVar[bool] = True
    needs: ClassVar[Needs] = Needs(elements="none", integration=None, cells="none")

    @abstractmethod
    def realisations(self, radio: Radio, truth: PointCloud) -> list[PointCloud]:
        """Make all realisations from a truth.

        Parameters
        ----------
        radio : Radio
            Scenario or observation.
        """

    @one_blas_thread()
    def estimate(self, observation: Observation, truth: PointCloud | None = None) -> PointCloud:
        """Select the realisation whose deviation is nearest to the mean deviation.

        Parameters
        ----------
        observation : Observation
            Only its system, array, frame, base station and region are used.

        Raises
        ------
        InputError
            Without a truth.
        """
        if truth is None:
            raise InputError(
                f"estimator {self.name} needs the truth: call estimate(observation, scenario.truth)"
            )
        if not len(truth):
            return PointCloud.empty()
        clouds = self.realisations(observation, truth)
        bin_mps = observation.system.velocity_bin_mps
        return clouds[nearest_to_mean(truth, clouds, observation.region, bin_mps)]


GENERATOR = (1, 3, 11, 29)
"""Generator of the rank-1 lattice of offsets. It has the least P_2 of all odd generators, 3.67; for random
offsets 5.28 is expected. Its squared wrap-around L2 discrepancy is 0.0034; random offsets have 0.029."""


def lattice_offsets() -> Floats:
    """Offsets of the lattice of cells: a rank-1 lattice in four dimensions.

    Returns
    -------
    ndarray of float64, shape (64, 4)
        In cells, along range, velocity, u and w. Each column has every odd multiple of 1/128
        below 1 once.

    References
    ----------
    Sloan and Joe, "Lattice Methods for Multiple Integration", 1994: rank-1 lattices and P_2.
    """
    steps = np.arange(N_REALISATIONS)[:, None] * np.array(GENERATOR) % N_REALISATIONS
    return (steps + 0.5) / N_REALISATIONS


@dataclass(frozen=True)
class Oracle(Reference):
    """Truth at the radio's resolution: scatterers of one Rayleigh cell become their centroid.

    Attributes
    ----------
    cell : float
        Size of a cell in Rayleigh cells, along each of range, velocity, u and w.

    Raises
    ------
    InputError
        If the size is no positive number.
    """

    cell: float = 1.0

    name: ClassVar[str] = "oracle"

    def __post_init__(self) -> None:
        require(0 < self.cell < np.inf, "cell", self.cell, "a positive number of Rayleigh cells")

    def realisations(self, radio: Radio, truth: PointCloud) -> list[PointCloud]:
        """Merge the truth in the cells of each of the 64 lattices.

        Parameters
        ----------
        radio : Radio
            Scenario or observation.

        Returns
        -------
        list of PointCloud
            Centroids in x, y, z and v; the powers of a cell are summed.
        """
        places = radio_places(radio, truth) / (self.cell * rayleigh_cells(radio))
        points = truth.to_array()
        return [
            PointCloud.from_array(_merged(points, np.floor(places + offset))) for offset in lattice_offsets()
        ]


def _merged(points: Floats, cells: Floats) -> Floats:
    """Merge points (n, 5) of equal cells (n, 4): means of x, y, z and v, sums of the power."""
    if not len(points):
        return points
    order = np.lexsort(cells.T)
    ordered = cells[order]
    is_first = np.r_[True, (ordered[1:] != ordered[:-1]).any(axis=1)]
    starts = np.flatnonzero(is_first)
    merged: Floats = np.add.reduceat(points[order], starts, axis=0)
    merged[:, :4] /= np.diff(starts, append=len(points))[:, None]
    return merged


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
