"""The observation that an estimator gets, and the conversion of its detections into a point cloud."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from isacbench.checked_arrays import Complex, Floats, Integers, Mask, checked_array
from isacbench.choices import Sensing
from isacbench.display import Description, Displayed, range_text
from isacbench.errors import InputError
from isacbench.model.array import VirtualArray
from isacbench.model.cloud import PointCloud
from isacbench.model.frame import Frame
from isacbench.model.gate import Gate
from isacbench.model.kernels import PERIOD, within_period
from isacbench.model.numerology import System
from isacbench.model.region import Interval, Region

REGION_TOLERANCE_M = 0.5
"""Largest distance outside the region at which a point is still reported."""

REGION_SAMPLES = 17
"""Points per edge at which directions of the region are sampled: exact to about 1e-3 on a street."""

NEAR_SAMPLES = 12
"""Further samples to either side of a base station so near that directions change faster between points."""

NEAREST_SAMPLE = 1e-3
"""Distance of the first further sample, as a share of the base station's distance: in the frame ``paper``
all directions meet straight below it."""


@dataclass(frozen=True, eq=False, repr=False)
class Observation(Displayed):
    """Noisy range-Doppler cells of the gate, and what is known of the radio and the region.

    Attributes
    ----------
    cells : ndarray of complex128 or complex64, shape (n_range, n_doppler, P, Q)
        Range-Doppler map of every virtual element, from unitary transforms; read-only.
    gate : Gate
        The bins that the first two axes stand for.
    base_station_m : ndarray of float64, shape (3,)
    sensing : {"all", "prs"}
        Resource elements used for sensing.
    """

    cells: Complex
    gate: Gate
    system: System
    array: VirtualArray
    frame: Frame
    base_station_m: Floats
    region: Region
    sensing: Sensing = "all"

    def __post_init__(self) -> None:
        cells = checked_array("cells", self.cells, np.complex64)
        if cells.shape != (*self.gate.shape, *self.array.shape):
            raise InputError(
                f"cells: have shape {cells.shape}; allowed is {(*self.gate.shape, *self.array.shape)}, "
                "bins of the gate and virtual elements"
            )
        object.__setattr__(self, "cells", cells)

    def _description(self) -> Description:
        (n_range, n_doppler), (n_p, n_q) = self.gate.shape, self.array.shape
        range_bins, doppler_bins = self.gate.range_bins, self.gate.doppler_bins
        range_m = range_bins * self.system.range_bin_m
        velocity_mps = doppler_bins * self.system.velocity_bin_mps
        cells = f"{self.cells.dtype}, {self.cells.nbytes / 1e6:.3g} MB" if self.has_cells else "not read yet"
        return Description(
            f"Observation: {n_range} x {n_doppler} range-Doppler cells of {n_p} x {n_q} virtual elements",
            {
                "cells": cells,
                "sensing": self.sensing,
                "range": f"{range_text(range_m, 'm')} (bins {range_text(range_bins)})",
                "velocity": f"{range_text(velocity_mps, 'm/s')} (bins {range_text(doppler_bins)})",
                "region": str(self.region),
            },
        )

    @property
    def has_cells(self) -> bool:
        """True if `cells` is computed, False if it is still to be computed from a recorded frame."""
        return "cells" in vars(self)

    @cached_property
    def cross(self) -> Complex:
        """Cells (n_range, n_doppler, P + Q - 1) of the elements (p, 0), then of (0, q) from q = 1."""
        cross = cross_of(self.cells)
        cross.setflags(write=False)
        return cross

    @cached_property
    def cosine_limits(self) -> tuple[Interval, Interval]:
        """Lowest and highest u, and w, that a point of the region can have, its tolerance included."""
        return cosine_limits(self.region, self.base_station_m, self.frame)

    def cloud(
        self, range_bin: ArrayLike, doppler_bin: ArrayLike, u: ArrayLike, w: ArrayLike, power: ArrayLike
    ) -> PointCloud:
        """Place detections in space and drop what cannot be in the region.

        Parameters
        ----------
        range_bin, doppler_bin : array_like, shape (n,)
            Absolute, possibly fractional bins. Bins a whole transform length
            apart are the same; the one nearest to the middle of the region's
            ranges and speeds is taken.
        u, w : array_like, shape (n,)
            Direction cosines; those outside the visible region are dropped.
        power : array_like, shape (n,)
            Echo power relative to a unit scatterer.

        Returns
        -------
        PointCloud
            Points at most 0.5 m outside the region.
        """
        system = self.system
        xyz = self.positions_m(range_bin, u, w)
        doppler = checked_array("doppler_bin", doppler_bin)
        velocity = _unfolded(doppler, self.region.speed_mps, system.velocity_bin_mps, system.n_symbols)
        keep = self.region.contains(xyz, REGION_TOLERANCE_M)
        return PointCloud(xyz[keep], velocity[keep], checked_array("power", power)[keep])

    def positions_m(self, range_bin: ArrayLike, u: ArrayLike, w: ArrayLike) -> Floats:
        """Place ranges and directions in space.

        Parameters
        ----------
        range_bin : array_like, shape (n,)
            As in `cloud`.
        u, w : array_like, shape (n,)
            Direction cosines.

        Returns
        -------
        ndarray of float64, shape (n, 3)
            In metres; NaN where no echo can come from: outside the visible
            region, and at ranges below 0 by more than an error of estimation.
        """
        system, limits_m = self.system, self.region.range_limits_m(self.base_station_m)
        cosines = self.unfolded(u, w)
        ranges = checked_array("range_bin", range_bin)
        range_m = _unfolded(ranges, limits_m, system.range_bin_m, system.n_subcarriers)
        xyz = self.base_station_m + self.frame.offsets(np.maximum(range_m, 0), *cosines)
        xyz[range_m < -system.range_bin_m / 2] = np.nan
        return xyz

    def unfolded(self, u: ArrayLike, w: ArrayLike) -> tuple[Floats, Floats]:
        """Choose among the aliases of u and w, 2 apart, those nearest to the middle of the region's limits.

        Only elements more than half a wavelength apart have several aliases in space.
        """
        found = checked_array("u", u), checked_array("w", w)
        is_unique = self.frame.cosine_scale <= 1
        of_u, of_w = (
            each if alone else within_period(each, sum(limits) / 2)
            for each, alone, limits in zip(found, is_unique, self.cosine_limits, strict=True)
        )
        return of_u, of_w

    def sees(self, u: Floats, w: Floats) -> Mask:
        """Tell which u and w, of equal shapes, are of a direction in space, or have an alias that is."""
        return self.frame.visible(*self.unfolded(u, w))


def cosine_limits(region: Region, base_station_m: Floats, frame: Frame) -> tuple[Interval, Interval]:
    """Lowest and highest u, and w, that a point of a region can have, its tolerance included.

    Where they are further apart than aliases, 2, it is a period in their middle.
    """
    limits = spanned_limits(region, base_station_m, frame)
    middles = [(low + high) / 2 for low, high in limits]
    (u, w) = (
        each if each[1] - each[0] <= PERIOD else (middle - PERIOD / 2, middle + PERIOD / 2)
        for each, middle in zip(limits, middles, strict=True)
    )
    return u, w


def spanned_limits(region: Region, base_station_m: Floats, frame: Frame) -> tuple[Interval, Interval]:
    """Lowest and highest u, and w, that a point of a region can have, whatever their distance."""
    lower, upper = region.lower_m - REGION_TOLERANCE_M, region.upper_m + REGION_TOLERANCE_M
    if np.all((base_station_m > lower) & (base_station_m < upper)):
        scale_u, scale_w = map(float, frame.cosine_scale)
        return (-scale_u, scale_u), (-scale_w, scale_w)
    axes = _samples(lower, upper, base_station_m)
    offset_m = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3) - base_station_m
    visible = frame.in_half_space(offset_m) & (np.linalg.norm(offset_m, axis=1) > 0)
    u, w = frame.direction_cosines(offset_m[visible])
    return (float(u.min()), float(u.max())), (float(w.min()), float(w.max()))


def _samples(lower_m: Floats, upper_m: Floats, base_m: Floats) -> list[Floats]:
    """Coordinates along x, y and z of a grid of points in a box, which show its limits in direction."""
    axes = [*np.linspace(lower_m, upper_m, REGION_SAMPLES, axis=1)]
    distance_m = float(np.linalg.norm(np.clip(base_m, lower_m, upper_m) - base_m))
    longest_m = float((upper_m - lower_m).max())
    if distance_m * (REGION_SAMPLES - 1) >= longest_m:
        return axes
    steps_m = np.geomspace(NEAREST_SAMPLE * max(distance_m, REGION_TOLERANCE_M), longest_m, NEAR_SAMPLES)
    around_m = np.r_[-steps_m[::-1], 0, steps_m]
    return [
        np.r_[axis, np.clip(base + around_m, axis[0], axis[-1])]
        for axis, base in zip(axes, base_m, strict=True)
    ]


def _unfolded(places: Floats, limits: Interval, size: float, n_bins: int) -> Floats:
    """Ranges or speeds of bins: of all aliases the one nearest to the middle of the limits."""
    turns = np.rint((places - sum(limits) / 2 / size) / n_bins)
    return (places - n_bins * turns) * size


def cross_elements(shape: tuple[int, int]) -> Integers:
    """Indices (P + Q - 1, 2) of the elements of one column and one row: (p, 0), then (0, q) from q = 1."""
    n_p, n_q = shape
    p, q = np.arange(n_p), np.arange(1, n_q)
    return np.stack([np.r_[p, np.zeros_like(q)], np.r_[np.zeros_like(p), q]], axis=1)


def cross_of(cells: Complex) -> Complex:
    """Take one column and one row of the array (..., P, Q), in the order of `cross_elements`."""
    p, q = cross_elements((cells.shape[-2], cells.shape[-1])).T
    return cells[..., p, q]
