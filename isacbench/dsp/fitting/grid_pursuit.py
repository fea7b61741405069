"""Orthogonal matching pursuit over a grid of atoms in range, Doppler, u and w.

The best atom is sought on a coarse grid, a list of range-Doppler places times
all pairs of directions, then among the atoms of a finer grid around it, and
placed between those by a parabola along each coordinate. An atom is a product
of four real factors (`isacbench.dsp.fitting.atoms`): its products with the
whole grid are products of small matrices, and neither the dictionary nor the
residual map is ever filled. Atoms of a few range bins see few dimensions of the
map, in which it is kept for all atoms there.

References
----------
Pati, Rezaiifar and Krishnaprasad, "Orthogonal matching pursuit", Asilomar
(1993).
Rubinstein, Zibulevsky and Elad, "Efficient implementation of the K-SVD
algorithm using batch orthogonal matching pursuit", Technion CS-2008-08 (2008),
on updates by a growing Cholesky factor.
"""

from __future__ import annotations

from functools import cache
from math import ceil
from typing import NamedTuple

import numpy as np

from isacbench.checked_arrays import Complex, Floats
from isacbench.dsp.angles.peaks import vertex
from isacbench.dsp.fitting.atoms import N_COORDINATES, AtomMap, sum_of_echoes

EQUAL = 1e-9
"""Relative difference of energies that is rounding."""

FLAT = 1e-6
"""Relative difference of three energies up to which a parabola through them is rounding."""

STEPS_BETWEEN = 2**12
"""Places between two samples of the finer grid."""

NEIGHBOURS = np.array([-1, 0, 1])
"""Steps to a sample and its two neighbours."""

UNSEEN = 1e-24
"""Energy of an atom's factor up to which the map does not see it: an exact null, but for rounding."""

TINY = float(np.finfo(np.float64).tiny)
"""Level of an exact null."""

BLOCK_BINS, MORE_DIMENSIONS = 4, 12
"""Range bins whose atoms share a map, and dimensions to spare: what others add to an atom is below 1e-11."""

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
    search = _Search(atom_map, grid, n_most)
    members = _Members(atom_map, n_most)
    while len(members) < n_most:
        best = search.best()
        if best is None:
            break
        place = search.zoomed(best, members.amplitude) if grid.zoom > 1 else search.place(best)
        factors = [atom_map.factors(place[None, axis], axis) for axis in range(N_COORDINATES)]
        if not members.take(place, factors, search.matched(best, factors), least_energy):
            break
        if len(members) == 1:
            first_energy = abs(members.newest[0]) ** 2
            least_energy = max(least_energy, first_energy * 10 ** (-dynamic_range_db / 10))
        search.subtract(members, factors)
    return PursuitResult(members.places, members.amplitude)


class _Members:
    """Atoms chosen so far, with the growing inverse of the Cholesky factor of their Gram matrix.

    Its rows are sums of atoms orthonormal to each other.
    """

    def __init__(self, atom_map: AtomMap, n_most: int) -> None:
        self._n = 0
        self._inverse = np.zeros((n_most, n_most))
        self._coordinates, self._amplitude = np.zeros((2, n_most), dtype=np.complex128)
        self._places = np.empty((n_most, N_COORDINATES))
        self._lines = [np.empty((n_most, line.value.shape[1])) for line in atom_map.lines(self._places[:0])]

    def __len__(self) -> int:
        return self._n

    @property
    def places(self) -> Floats:
        """Places (k, 4) of all atoms."""
        return self._places[: self._n]

    @property
    def amplitude(self) -> Complex:
        """Least-squares amplitudes (k,) of all atoms."""
        return self._amplitude[: self._n]

    @property
    def newest(self) -> tuple[complex, Floats]:
        """Amplitude of the newest orthonormal sum of atoms, and that sum (k,)."""
        k = self._n - 1
        return complex(self._coordinates[k]), self._inverse[k, : k + 1]

    def take(self, place: Floats, factors: list[Floats], matched: complex, least_energy: float) -> bool:
        """Add the atom at a place (4,), if it takes enough energy; tell whether it did.

        `factors` are its own, each (1, size), and `matched` is its product with the map.
        """
        k, row = self._n, np.ones(self._n)
        for members, factor in zip(self._lines, factors, strict=True):
            row *= members[:k] @ factor[0]
        energy = float(np.prod([np.sum(factor**2) for factor in factors]))
        before = self._inverse[:k, :k]
        shared = before @ row
        rest = energy - shared @ shared
        if rest < LEAST_NEW * energy:
            return False
        coordinate = (matched - shared @ self._coordinates[:k]) / np.sqrt(rest)
        if not abs(coordinate) ** 2 > least_energy:
            return False
        self._inverse[k, :k], self._inverse[k, k] = -(shared @ before) / np.sqrt(rest), 1 / np.sqrt(rest)
        self._coordinates[k], self._places[k], self._n = coordinate, place, k + 1
        self._amplitude[: k + 1] += coordinate * self._inverse[k, : k + 1]
        for members, factor in zip(self._lines, factors, strict=True):
            members[k] = factor[0]
        return True


class _Axis:
    """Samples of a grid along one coordinate, the finer samples around each, and members' factors there.

    Attributes
    ----------
    places : ndarray of float64, shape (n, z)
        The finer samples around each of n samples, which is in their middle.
    factors : ndarray of float64, shape (n, z, size)
        Of atoms there, over their norms; 0 of atoms that the map does not see.
    shown : ndarray of float64, shape (n, n_most, z)
        Products of these factors with those of the members.
    """

    def __init__(self, atom_map: AtomMap, axis: int, samples: Floats, grid: PlaceGrid, n_most: int) -> None:
        offsets = np.arange(-grid.zoom, grid.zoom + 1) / grid.zoom
        self.places = samples[:, None] + grid.steps[axis] * offsets
        factors = atom_map.factors(self.places.ravel(), axis)
        energy = np.sum(factors**2, axis=1, keepdims=True)
        factors *= np.divide(1, np.sqrt(energy), out=np.zeros_like(energy), where=energy > UNSEEN)
        self.factors = factors.reshape(*self.places.shape, factors.shape[1])
        self.shown = np.empty((len(samples), n_most, self.places.shape[1]))
        self.middle = grid.zoom


class _Search:
    """Products of the residual with all atoms of the coarse grid.

    Indices of an atom are those of its samples along range, Doppler, u and w.
    """

    def __init__(self, atom_map: AtomMap, grid: PlaceGrid, n_most: int) -> None:
        self._atom_map, self._half_block = atom_map, grid.steps[0] + BLOCK_BINS / 2
        self._near = cache(self._map_near)
        range_bins, self._range_of = np.unique(grid.bins[:, 0], return_inverse=True)
        doppler_bins, self._doppler_of = np.unique(grid.bins[:, 1], return_inverse=True)
        samples = (range_bins, doppler_bins, grid.u, grid.w)
        self._axes = [_Axis(atom_map, axis, line, grid, n_most) for axis, line in enumerate(samples)]
        self._residual = self._matched()
        self._over_bins = np.empty((n_most, len(grid.bins)))
        self._over_directions = np.empty((n_most, grid.u.size * grid.w.size))

    def best(self) -> tuple[int, ...] | None:
        """Indices of the atom that takes most energy from the residual; None if none takes any."""
        if not self._residual.any():
            return None
        bins, direction = _largest(np.sum(self._residual**2, axis=0))
        u, w = divmod(direction, len(self._axes[3].places))
        return int(self._range_of[bins]), int(self._doppler_of[bins]), u, w

    def place(self, atom: tuple[int, ...]) -> Floats:
        """Place (4,) of an atom of the coarse grid."""
        return np.array([along.places[at, along.middle] for along, at in zip(self._axes, atom, strict=True)])

    def zoomed(self, atom: tuple[int, ...], amplitude: Complex) -> Floats:
        """Place (4,) of the best atom within a step of an atom, between the samples of the finer grid."""
        here = list(zip(self._axes, atom, strict=True))
        basis, near = self._near(self._block(atom))
        in_range, *others = (along.factors[at] for along, at in here)
        residual = near.matched_separably([in_range @ basis, *others])
        residual -= sum_of_echoes(amplitude, *(along.shown[at, : amplitude.size] for along, at in here))
        gain = residual.real**2 + residual.imag**2
        return _between(gain, _largest(gain), np.array([along.places[at] for along, at in here]))

    def matched(self, atom: tuple[int, ...], factors: list[Floats]) -> complex:
        """Product of the map with an atom within a step of one of the grid, from its factors (1, size)."""
        basis, near = self._near(self._block(atom))
        return complex(near.matched_separably([factors[0] @ basis, *factors[1:]])[0, 0, 0, 0])

    def _block(self, atom: tuple[int, ...]) -> int:
        """Number of the range bins that an atom of the grid lies in."""
        return int(self._axes[0].places[atom[0], self._axes[0].middle] // BLOCK_BINS)

    def _map_near(self, block: int) -> tuple[Floats, AtomMap]:
        """Basis (n_range, d) of the factors of atoms within a step of some range bins, and the map in it."""
        n = ceil(np.pi * self._half_block) + MORE_DIMENSIONS
        nodes = np.cos(np.pi * (np.arange(n) + 0.5) / n)
        places = BLOCK_BINS * (block + 0.5) + self._half_block * nodes
        basis = np.linalg.qr(self._atom_map.factors(places, 0).T)[0]
        return basis, self._atom_map.along(basis)

    def subtract(self, members: _Members, factors: list[Floats]) -> None:
        """Subtract what the newest member, of the factors (1, size), explains orthogonal to all others."""
        k, (amplitude, share) = len(members), members.newest
        for along, factor in zip(self._axes, factors, strict=True):
            along.shown[:, k - 1] = along.factors @ factor[0]
        in_range, in_doppler, u, w = (along.shown[:, k - 1, along.middle] for along in self._axes)
        self._over_bins[k - 1] = in_range[self._range_of] * in_doppler[self._doppler_of]
        self._over_directions[k - 1] = np.outer(u, w).ravel()
        shown = self._over_bins[:k].T @ (self._over_directions[:k] * share[:, None])
        for part, height in zip(self._residual, (amplitude.real, amplitude.imag), strict=True):
            part -= height * shown

    def _matched(self) -> Floats:
        """Products (2, m, g h) of the map, its parts in front, with all atoms of the coarse grid."""
        in_range, in_doppler, u, w = (along.factors[:, along.middle] for along in self._axes)
        snapshots = np.empty((self._range_of.size, u.shape[1] * w.shape[1]), dtype=np.complex128)
        for k, row in enumerate(self._atom_map.ranges(in_range)):
            here = self._range_of == k
            snapshots[here] = (in_doppler[self._doppler_of[here]] @ row).view(np.complex128)
        beams = np.asarray(u @ (snapshots.reshape(-1, u.shape[1], w.shape[1]) @ w.T), dtype=np.complex128)
        flat = beams.reshape(len(snapshots), len(u) * len(w))
        return np.stack([flat.real, flat.imag])


def _largest(gain: Floats) -> tuple[int, ...]:
    """Index of the largest value, the first of those that are equal but for rounding."""
    first = int(np.argmax(gain >= gain.max() * (1 - EQUAL)))
    return tuple(map(int, np.unravel_index(first, gain.shape)))


def _between(gain: Floats, best: tuple[int, ...], lines: Floats) -> Floats:
    """Place (4,) of a maximum among lines (4, z) of places, by parabolas through three levels."""
    at, axes, last = np.array(best), np.arange(N_COORDINATES), lines.shape[1] - 1
    three = np.clip(at + np.eye(N_COORDINATES, dtype=np.int64)[:, None] * NEIGHBOURS[:, None], 0, last)
    # Of ratios, which no unit changes.
    levels = np.log(np.maximum(gain[tuple(np.moveaxis(three, -1, 0))] / gain[best], TINY))
    # To a few digits: later atoms would magnify what rounding makes of the others.
    offset = np.rint(vertex(*levels.T) * STEPS_BETWEEN) / STEPS_BETWEEN
    is_between = (at > 0) & (at < last) & (levels.min(axis=1) <= -FLAT)
    place: Floats = lines[axes, at] + np.where(is_between, offset, 0) * (lines[:, 1] - lines[:, 0])
    return place
