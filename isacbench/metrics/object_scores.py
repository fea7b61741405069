"""Scores of objects: points of an image grouped into objects, and assigned one to one to the true ones."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter
from scipy.optimize import linear_sum_assignment
from skimage.measure import label
from skimage.morphology import reconstruction
from skimage.segmentation import watershed

from isacbench.checked_arrays import Floats, Mask
from isacbench.errors import require
from isacbench.metrics.assignment import connected_pieces
from isacbench.metrics.descriptions import ANY_KIND, ScoreColumn, object_kind
from isacbench.metrics.geometry import CloudPair
from isacbench.model.cloud import PointCloud
from isacbench.model.radio_coordinates import radio_places, rayleigh_cells
from isacbench.model.scene import Scenario

VOXEL_CELLS = np.array([3.0, 3.0, 0.125, 0.25])
"""Voxel in Rayleigh cells of range, velocity, u and w: 0.9 m, 5.5 m/s, and at 80 m 1.3 m and 2.5 m across.
Chosen on developing scenes by how many of the true objects their own scatterers make (docs/metrics.md)."""

REACH_VOXELS = 1.5
SMOOTHING_VOXELS = 1.0
VALLEY = 1.1
"""Where objects touch: the density of points, smoothed, has two peaks, each this many times the saddle."""

MOST_VOXELS = 2**24
"""Of a piece that is split: 0.5 GB."""

LATTICE_MARGIN = 1e-6
"""Voxels by which distances differ at least: points in the middle of bins are whole voxels apart."""

ROUNDING = 1e-9
ERRORS = ("horizontal", "m"), ("vertical", "m"), ("velocity", "mps"), ("extent", "m")
UNITS = {"m": "m", "mps": "m/s"}
"""Errors of detected objects, with the ends of their columns' names, and their units."""


@dataclass(frozen=True, eq=False)
class ObjectList:
    """Objects, true or found.

    Attributes
    ----------
    centre_m : ndarray of float64, shape (n, 3)
        Centres of the boxes around their points.
    extent_m : ndarray of float64, shape (n, 3)
        Sizes of these boxes along x, y and z.
    velocity_mps : ndarray of float64, shape (n,)
        Mean radial velocities.
    kinds : tuple of str
        Kinds of true objects, empty for found ones.
    """

    centre_m: Floats
    extent_m: Floats
    velocity_mps: Floats
    kinds: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.velocity_mps)


class Matches(NamedTuple):
    """Assignment of found objects to true ones.

    Attributes
    ----------
    i, j : ndarray of int
        Indices of a true and of a found object, for each pair.
    """

    truth: ObjectList
    found: ObjectList
    i: NDArray[np.intp]
    j: NDArray[np.intp]

    def errors(self) -> Floats:
        """Errors (n, 4) of the pairs: horizontal and vertical in m, velocity in m/s, and of the box in m."""
        offset_m = self.found.centre_m[self.j] - self.truth.centre_m[self.i]
        speed_mps = self.found.velocity_mps[self.j] - self.truth.velocity_mps[self.i]
        extent_m = self.found.extent_m[self.j] - self.truth.extent_m[self.i]
        horizontal_m, box_m = (np.linalg.norm(each, axis=1) for each in (offset_m[:, :2], extent_m))
        return np.column_stack([horizontal_m, np.abs(offset_m[:, 2]), np.abs(speed_mps), box_m])


def _columns() -> tuple[ScoreColumn, ...]:
    what = {
        "horizontal": "horizontal error of the centre",
        "vertical": "vertical error of the centre",
        "velocity": "error of the radial velocity",
        "extent": "error of the box's size",
    }
    return (
        ScoreColumn("n_objects", "true objects", "", "neither"),
        ScoreColumn("n_objects_missed", "true objects that were missed"),
        ScoreColumn("n_objects_false", "found objects that are none", "", "lower", 0.0),
        ScoreColumn("objects_f_score", "F-score of objects matched one to one", "", "higher", 0.0),
        ScoreColumn("objects_detected", "share of the true objects that were detected", "", "higher", 0.0),
        *(
            ScoreColumn(
                f"objects_{error}_{unit}", f"{what[error]}, detected objects", UNITS[unit], "lower", math.nan
            )
            for error, unit in ERRORS
        ),
        ScoreColumn("detected_*", "share of * that were detected", "", "higher", 0.0),
        *(
            ScoreColumn(f"{error}_*_{unit}", f"{what[error]}, detected *", UNITS[unit], "lower", math.nan)
            for error, unit in ERRORS
        ),
    )


@dataclass(frozen=True)
class Objects:
    """Objects detected, missed and false, and their errors of position, velocity and size, by kind.

    Attributes
    ----------
    gate_m : float
        Largest distance in m of the centres of a true and a found object that may be one.
    gate_mps : float
        Largest difference in m/s of their velocities.
    voxel : float
        Size of the voxels that points are grouped by, over that of `VOXEL_CELLS`.

    Raises
    ------
    InputError
        If a parameter is no positive number.
    """

    gate_m: float = 2.0
    gate_mps: float = 5.0
    voxel: float = 1.0

    name: ClassVar[str] = "objects"
    version: ClassVar[int] = 1
    columns: ClassVar[tuple[ScoreColumn, ...]] = _columns()

    def __post_init__(self) -> None:
        for name in ("gate_m", "gate_mps", "voxel"):
            require(0 < getattr(self, name) < np.inf, name, getattr(self, name), "a positive number")

    def lacks(self, scenario: Scenario | None) -> str:
        """Say why the objects of a scenario cannot be scored.

        Returns
        -------
        str
            Empty where they can.
        """
        if scenario is None:
            return "it needs a scenario as truth, which says what the objects are"
        names = scenario.scatterers.objects or ("",) * len(scenario.scatterers)
        if alone := sum(not object_kind(name) for name in names):
            return (
                f"scenario {scenario.name}: {alone} of {len(names)} points belong to no object; give the "
                "objects of a csv of points in a column object, such as car 1"
            )
        return ""

    def score(self, pair: CloudPair) -> dict[str, float]:
        """Score a pair.

        Returns
        -------
        dict of str to float
            NaN where velocities are unknown, by which points are grouped; so are the errors of a kind none
            of which was detected.
        """
        if not pair.has_velocities or pair.scenario is None:
            return dict.fromkeys(
                (column.name for column in self.columns if ANY_KIND not in column.name), math.nan
            )
        matches = self.matches(pair.scenario, pair.estimate)
        n_true, n_found, n_pairs = len(matches.truth), len(matches.found), matches.i.size
        scores = {
            "n_objects": n_true,
            "n_objects_missed": n_true - n_pairs,
            "n_objects_false": n_found - n_pairs,
            "objects_f_score": 2 * n_pairs / (n_true + n_found),
        }
        kinds, errors = np.array(matches.truth.kinds), matches.errors()
        of_pairs = kinds[matches.i]
        for kind, is_true, is_pair in (
            ("", np.ones(n_true, dtype=bool), np.ones(n_pairs, dtype=bool)),
            *((kind, kinds == kind, of_pairs == kind) for kind in sorted(set(kinds.tolist()))),
        ):
            means = errors[is_pair].mean(axis=0) if is_pair.any() else np.full(len(ERRORS), math.nan)
            names = [
                f"{error}_{kind}_{unit}" if kind else f"objects_{error}_{unit}" for error, unit in ERRORS
            ]
            scores[f"detected_{kind}" if kind else "objects_detected"] = is_pair.sum() / is_true.sum()
            scores |= dict(zip(names, means.tolist(), strict=True))
        return scores

    def matches(self, scenario: Scenario, estimate: PointCloud) -> Matches:
        """Group the points of an image, and assign the groups to the objects of the scenario.

        As many as possible are assigned whose centres and velocities agree within the gates; of these
        assignments, the one of the least distances.
        """
        truth = true_objects(scenario)
        # Of equally good assignments, which one is found does not depend on the order of points.
        estimate = estimate.select(np.lexsort(estimate.to_array().T))
        found = described(estimate, group_points(scenario, estimate, self.voxel))
        distance_m = np.linalg.norm(truth.centre_m[:, None] - found.centre_m[None], axis=2)
        inside = distance_m <= self.gate_m
        inside &= np.abs(truth.velocity_mps[:, None] - found.velocity_mps[None]) <= self.gate_mps
        # A pair is worth more than all that the distances of others can lose.
        worth = (min(distance_m.shape) + 1) * self.gate_m
        i, j = linear_sum_assignment(np.where(inside, distance_m - worth, 0.0))
        kept = inside[i, j]
        return Matches(truth, found, i[kept], j[kept])


@lru_cache(maxsize=8)
def true_objects(scenario: Scenario) -> ObjectList:
    """Objects of a scenario: the boxes around their scatterers, and mean radial velocities."""
    names, group = np.unique(scenario.scatterers.objects, return_inverse=True)
    kinds = tuple(map(object_kind, names.tolist()))
    return replace(described(scenario.truth, group + 1), kinds=kinds)


def described(cloud: PointCloud, group: NDArray[np.intp]) -> ObjectList:
    """Centres, sizes and velocities of groups of points.

    Parameters
    ----------
    group : ndarray of int, shape (n,)
        Group of each point, from 1.
    """
    if not len(cloud):
        return ObjectList(np.empty((0, 3)), np.empty((0, 3)), np.empty(0))
    order = np.argsort(group, kind="stable")
    start = np.flatnonzero(np.diff(group[order], prepend=0))
    columns = np.column_stack([cloud.xyz, cloud.velocity])[order]
    least, most, total = (of.reduceat(columns, start) for of in (np.minimum, np.maximum, np.add))
    velocity_mps = total[:, 3] / np.diff(start, append=group.size)
    return ObjectList((least + most)[:, :3] / 2, (most - least)[:, :3], velocity_mps)


def group_points(scenario: Scenario, cloud: PointCloud, voxel: float = 1.0) -> NDArray[np.intp]:
    """Group the points of an image into objects.

    Points whose voxels touch, by a corner at least, hang together. What hangs together is split by a
    watershed of the density of points if this has several peaks, see `VALLEY`. A lone point is an object.

    Parameters
    ----------
    scenario : Scenario
        Its radio sets the size of the voxels.
    voxel : float
        Size of voxels, over that of `VOXEL_CELLS`.

    Returns
    -------
    ndarray of int, shape (n,)
        Group of each point, from 1.
    """
    places = radio_places(scenario, cloud) / (voxel * VOXEL_CELLS * rayleigh_cells(scenario))
    group, n_groups = np.zeros(len(cloud), dtype=np.intp), 0
    for members in connected_pieces(places / (REACH_VOXELS + LATTICE_MARGIN)):
        voxels = np.floor(places[members] - places[members].min(axis=0) + LATTICE_MARGIN)
        group[members] = n_groups + _parts(voxels)
        n_groups = int(group[members].max())
    return group


def _parts(voxels: Floats) -> NDArray[np.intp]:
    """Number the parts of a piece for each of its points (n, 4), from 1."""
    shape = voxels.max(axis=0) + 1.0
    if len(voxels) < 3 or shape.prod() > MOST_VOXELS:
        return np.ones(len(voxels), dtype=np.intp)
    index = tuple(voxels.astype(np.intp).T)
    occupied = np.zeros(shape.astype(np.intp), dtype=bool)
    occupied[index] = True
    return _watershed(occupied)[index]


def _watershed(occupied: Mask) -> NDArray[np.integer]:
    """Divide the occupied voxels (of four dimensions) of a piece between the peaks of their density."""
    density = gaussian_filter(occupied.astype(np.float64), SMOOTHING_VOXELS, mode="constant", truncate=2.5)
    peaks = (maximum_filter(density, 3, mode="constant") == density) & occupied
    if label(peaks, connectivity=4).max() == 1:
        return occupied.astype(np.intp)
    level = np.log(density, where=occupied, out=np.full(density.shape, -np.inf))
    height = math.log(VALLEY)
    level[~occupied] = level[occupied].min() - height
    around = np.ones((3,) * 4)
    dome = level - reconstruction(level - height, level, method="dilation", footprint=around)
    peaks = label((dome >= height - ROUNDING) & occupied, connectivity=4)
    return watershed(-level, peaks, mask=occupied, connectivity=around)
