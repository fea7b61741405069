"""Orthogonal matching pursuit over a grid of atoms in range, Doppler, u and w.

The best atom is sought on a coarse grid, a list of range-Doppler places times
all pairs of directions, then among the atoms of a finer grid around it, and
placed between those by a parabola along each coordinate. An atom is a product
of four real factors (`isacbench.dsp.fitting.atoms`): its products with the
whole grid are products of small matrices, and neither the dictionary nor the
residual map is ever filled.

References
----------
Pati, Rezaiifar and Krishnaprasad, "Orthogonal matching pursuit", Asilomar
(1993).
Rubinstein, Zibulevsky and Elad, "Efficient implementation of the K-SVD
algorithm using batch orthogonal matching pursuit", Technion CS-2008-08 (2008),
on updates by a growing Cholesky factor.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from isacbench.checked_arrays import Complex, Floats
from isacbench.dsp.angles.peaks import vertex
from isacbench.dsp.fitting.atoms import N_COORDINATES, AtomMap

EQUAL = 1e-9
"""Relative difference of energies that is rounding."""

FLAT = 1e-6
"""Relative difference of three energies up to which a parabola through them is rounding."""

STEPS_BETWEEN = 2**12
"""Places between two samples of the finer grid."""

TINY = float(np.finfo(np.float64).tiny)
"""Level of an exact null."""

LEAST_NEW = 1e-3
"""Least share of an atom's energy that is orthogonal to those before: two atoms 0.02 Rayleigh cells apart."""


class PlaceGrid(NamedTuple):
    """Places in Rayleigh cells among which atoms are sought.

    Attributes
    ----------
    bins : ndarray of float64, shape (m, 2)
        Places along range and Doppler.
    u, w : ndarray of float64, shapes (g,) and (h,)
        Directions, each of which goes with each of the others and each place.
    steps : ndarray of float64, shape (4,)
        Distance of two neighbours along range, Doppler, u and w.
    zoom : int
        Atoms of the finer grid a step; 1 for none.
    """

    bins: Floats
    u: Floats
    w: Floats
    steps: Floats
    zoom: int


class PursuitResult(NamedTuple):
    """Atoms of a pursuit, in the order in which they were chosen.

    Attributes
    ----------
    places : ndarray of float64, shape (k, 4)
        In Rayleigh cells.
    amplitude : ndarray of complex128, shape (k,)
        Least-squares amplitudes of unit-energy atoms, all fitted together.
    """

    places: Floats
    amplitude: Complex


def pursue_on_grid(
    atom_map: AtomMap, grid: PlaceGrid, least_energy: float, dynamic_range_db: float, n_most: int
) -> PursuitResult:
    """Choose atoms one by one, at most `n_most`, each time the one that explains most of the residual.

    After each choice all amplitudes are the least-squares fit: the residual is orthogonal to every atom
    chosen. The pursuit ends where the best atom takes less than `least_energy` from the residual, is
    `dynamic_range_db` below the first one, which takes most, or is nearly a sum of those chosen before.
    """
    search = _Search(atom_map, grid)
    members = _Members(atom_map, n_most)
    while len(members) < n_most:
        best = search.best()
        if best is None:
            break
        place = search.zoomed(best, members) if grid.zoom > 1 else best
        if not members.take(place, least_energy):
            break
        if len(members) == 1:
            least_energy = max(least_energy, members.first_energy * 10 ** (-dynamic_range_db / 10))
        search.subtract(members)
    return PursuitResult(members.places, members.amplitude)


class _Members:
    """Atoms chosen so far, with the growing Cholesky factor of their Gram matrix.

    Attributes
    ----------
    places : ndarray of float64, shape (k, 4)
    lines : list of four ndarray of float64, shape (k, size)
        Factors along each coordinate.
    """

    def __init__(self, atom_map: AtomMap, n_most: int) -> None:
        self._atom_map = atom_map
        self._cholesky = np.zeros((n_most, n_most))
        self._coordinates = np.zeros(n_most, dtype=np.complex128)
        self.places = np.empty((0, N_COORDINATES))
        self.lines = [line.value for line in atom_map.lines(self.places)]

    def __len__(self) -> int:
        return len(self.places)

    @property
    def amplitude(self) -> Complex:
        """Least-squares amplitudes (k,) of all atoms."""
        return self._solved(self._coordinates[: len(self)])

    @property
    def first_energy(self) -> float:
        """Energy that the first atom has taken."""
        return float(np.abs(self._coordinates[0]) ** 2)

    @property
    def newest(self) -> tuple[complex, Floats]:
        """Amplitude of the newest orthonormal direction, and that direction as a sum of atoms (k,)."""
        k = len(self) - 1
        unit = np.zeros(k + 1, dtype=np.complex128)
        unit[k] = 1
        return complex(self._coordinates[k]), np.real(self._solved(unit)).astype(np.float64)

    def take(self, place: Floats, least_energy: float) -> bool:
        """Add the atom at a place (4,), if it takes enough energy; tell whether it did."""
        k, lines = len(self), self._atom_map.lines(place[None])
        factors = [line.value for line in lines]
        row = np.ones(k)
        for member, factor in zip(self.lines, factors, strict=True):
            row *= member @ factor[0]
        energy = float(np.prod([np.sum(factor**2) for factor in factors]))
        new = solve_triangular(self._cholesky[:k, :k], row, lower=True)
        rest = energy - new @ new
        if rest < LEAST_NEW * energy:
            return False
        matched = self._atom_map.correlate(lines).value[0]
        coordinate = (matched - new @ self._coordinates[:k]) / np.sqrt(rest)
        if not abs(coordinate) ** 2 > least_energy:
            return False
        self._cholesky[k, :k], self._cholesky[k, k] = new, np.sqrt(rest)
        self._coordinates[k] = coordinate
        self.places = np.concatenate([self.places, place[None]])
        self.lines = [np.concatenate(pair) for pair in zip(self.lines, factors, strict=True)]
        return True

    def _solved(self, right: Complex) -> Complex:
        k = len(right)
        return solve_triangular(self._cholesky[:k, :k], right, lower=True, trans="T")


class _Search:
    """Products of the residual with all atoms of the coarse grid."""

    def __init__(self, atom_map: AtomMap, grid: PlaceGrid) -> None:
        self._atom_map, self._grid = atom_map, grid
        places = (grid.bins[:, 0], grid.bins[:, 1], grid.u, grid.w)
        self._lines = [atom_map.line(places[axis], axis).value for axis in range(N_COORDINATES)]
        energy = [np.sum(line**2, axis=1) for line in self._lines]
        self._energy = (energy[0] * energy[1])[:, None], np.multiply.outer(energy[2], energy[3]).ravel()
        self._residual = _matched(atom_map.cells, self._lines)
        self._over_bins = np.empty((0, len(grid.bins)))
        self._over_directions = np.empty((0, self._energy[1].size))

    def best(self) -> Floats | None:
        """Place (4,) of the atom that takes most energy from the residual; None if none takes any."""
        if not self._residual.any():
            return None
        gain = self._residual.real**2 + self._residual.imag**2
        for energy in self._energy:
            gain /= energy
        bins, direction = _largest(gain)
        u, w = np.divmod(direction, self._grid.w.size)
        return np.array([*self._grid.bins[bins], self._grid.u[u], self._grid.w[w]])

    def zoomed(self, place: Floats, members: _Members) -> Floats:
        """Place (4,) of the best atom within a step of a place, between the samples of the finer grid."""
        zoom = self._grid.zoom
        offsets = np.arange(-zoom, zoom + 1) / zoom
        around = place[:, None] + self._grid.steps[:, None] * offsets
        lines = [self._atom_map.line(around[axis], axis).value for axis in range(N_COORDINATES)]
        residual = _matched_separably(self._atom_map.cells, lines)
        shown = [line @ member.T for line, member in zip(lines, members.lines, strict=True)]
        over_bins = (shown[0] * members.amplitude)[:, None] * shown[1]
        over_directions = shown[2][:, None] * shown[3]
        residual -= np.einsum("rdk,uwk->rduw", over_bins, over_directions, optimize=True)
        energy = [np.sum(line**2, axis=1) for line in lines]
        gain = residual.real**2 + residual.imag**2
        for axis, along in enumerate(energy):
            gain /= along.reshape([-1 if axis == other else 1 for other in range(N_COORDINATES)])
        best = _largest(gain)
        return np.array([_between(gain, best, around[axis], axis) for axis in range(N_COORDINATES)])

    def subtract(self, members: _Members) -> None:
        """Subtract what the newest member explains, orthogonal to all others."""
        products = [line @ member[-1] for line, member in zip(self._lines, members.lines, strict=True)]
        over_directions = np.multiply.outer(products[2], products[3]).ravel()
        self._over_bins = np.concatenate([self._over_bins, (products[0] * products[1])[None]])
        self._over_directions = np.concatenate([self._over_directions, over_directions[None]])
        amplitude, share = members.newest
        shown = (self._over_bins * share[:, None]).T @ self._over_directions
        self._residual.real -= amplitude.real * shown
        self._residual.imag -= amplitude.imag * shown


def _largest(gain: Floats) -> tuple[np.intp, ...]:
    """Index of the largest value, the first of those that are equal but for rounding."""
    first = int(np.argmax(gain >= gain.max() * (1 - EQUAL)))
    return np.unravel_index(first, gain.shape)


def _between(gain: Floats, best: tuple[np.intp, ...], line: Floats, axis: int) -> float:
    """Place of a maximum along one coordinate, by a parabola through the levels of three samples."""
    at = int(best[axis])
    line_gain = np.moveaxis(gain, axis, -1)[best[:axis] + best[axis + 1 :]]
    # Of ratios, which no unit changes.
    levels = np.log(np.maximum(line_gain / line_gain[at], TINY))
    if at in (0, len(line) - 1) or levels[at - 1 : at + 2].min() > -FLAT:
        return float(line[at])
    offset = vertex(levels[at - 1 : at], levels[at : at + 1], levels[at + 1 : at + 2])[0]
    # To a few digits: later atoms would magnify what rounding makes of the others.
    offset = np.rint(offset * STEPS_BETWEEN) / STEPS_BETWEEN
    return float(line[at] + offset * (line[1] - line[0]))


def _matched(cells: Complex, lines: list[Floats]) -> Complex:
    """Products (m, g h) of a map with atoms at m places, each in g x h directions."""
    n_range, n_doppler, n_u, n_w = cells.shape
    ranges, range_of_place = np.unique(lines[0], axis=0, return_inverse=True)
    snapshots = np.empty((len(lines[0]), n_u * n_w), dtype=np.complex128)
    for k, row in enumerate((ranges @ cells.reshape(n_range, -1)).reshape(-1, n_doppler, n_u * n_w)):
        here = range_of_place == k
        snapshots[here] = lines[1][here] @ row
    beams = np.asarray(lines[2] @ (snapshots.reshape(-1, n_u, n_w) @ lines[3].T), dtype=np.complex128)
    return beams.reshape(len(snapshots), len(lines[2]) * len(lines[3]))


def _matched_separably(cells: Complex, lines: list[Floats]) -> Complex:
    """Products (r, d, g, h) of a map with atoms at all combinations of four coordinates."""
    n_range, n_doppler, n_u, n_w = cells.shape
    rows = (lines[0] @ cells.reshape(n_range, -1)).reshape(-1, n_doppler, n_u * n_w)
    snapshots = (lines[1] @ rows).reshape(*(len(line) for line in lines[:2]), n_u, n_w)
    return lines[2] @ (snapshots @ lines[3].T)
