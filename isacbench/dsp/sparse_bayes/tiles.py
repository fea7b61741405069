"""Tiles of a map: windows in range and Doppler, perhaps tapered, whose echoes are learned on a joint grid.

A tile holds the echoes of a few range bins and of a few Doppler lines. Its grid
has all places in its window and in the angular sectors that its cells show;
margins on all sides take up the echoes of its neighbours, and are thrown away.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation

from isacbench.checked_arrays import Complex, Floats, Mask
from isacbench.dsp.sparse_bayes.learning import Noise, learn_directions, learn_grid, matched
from isacbench.dsp.sparse_bayes.places import Reach, merge_neighbours, strongest_near

HANN_SIDE = 0.25, 0.5
"""Weights of the neighbouring bins and of the middle one: a Hann window over the apertures of an `AtomMap`,
whose kernels are referred to their middle and therefore add up with equal signs."""

DIRECTION_STEP = 0.1
"""Largest step of the directions of the grid in Rayleigh cells."""

LEAST_DIRECTIONS = 24
"""Least directions along u and w each: a narrow region is sampled more finely."""

SECTOR_STRIDE = 2
"""Directions of the fine grid for one of the sectors' grid."""

SECTOR_STEPS = 4
"""Learning steps of the sectors."""

SECTOR_DIMENSION = 1e-2
"""Singular value, relative to the largest, of array dimensions that sectors are learned in."""

RANGE_STEP_BINS = 0.29
"""Step of the grid along range."""

RANGE_BEYOND_BINS = 1.0
"""Part of the grid beyond the first and the last range bin of a tile."""

GRID_STEPS = 8
"""Learning steps of a tile."""

MISFIT_DB = 45.0
"""Noise floor below the mean power of a tile, for what a grid cannot model."""

MOST_DIMENSIONS = 450
"""Data of a tile: time grows with the cube of it. Above, weak dimensions are left out."""

MOST_ATOMS = 300_000
"""Atoms of a tile's grid: time is proportional to it. Above, directions are left out evenly."""

FIRST_SHARE = 0.1
"""First powers, over those of a matched filter, which counts each echo on many places."""

LEAST_ENERGY = 1e-3
"""Least energy of an atom over the largest in the matched filter: those at the rim barely show."""

GRID_RANGE_DB = 40.0
"""Range below the strongest amplitude in which grid atoms are gathered."""

MOST_MERGED_ATOMS = 2000
"""Grid atoms that are gathered, the strongest first."""

DYNAMIC_RANGE_DB = 25.0
"""Range below the strongest atom within two range bins in which others are kept."""

NEAR_BINS = 2.0, np.inf
"""Range and Doppler bins that count as near within a tile."""

NEIGHBOUR_BOX = np.array([0.2, 0.2, 0.235, 0.235])
"""Half widths in Rayleigh cells of what one scatterer is spread over."""

CORE_BINS = 0.5
"""Distance below the first range bin from which atoms belong to a core."""


@dataclass(frozen=True, eq=False)
class BinTaper:
    """Sums of neighbouring bins.

    Attributes
    ----------
    weights : ndarray of float64, shape (n, n_bins)
        Rows of equal noise power 1.
    bins : ndarray of float64, shape (n,)
        Bins that the rows are centred on.
    """

    weights: Floats
    bins: Floats

    @classmethod
    def hann(cls, bins: Floats) -> BinTaper:
        """Sum each bin and its neighbours; bins at the ends, which lack one, are left out.

        Parameters
        ----------
        bins : ndarray of float64, shape (n_bins,)
            Neighbouring bins. Fewer than three are left as they are.
        """
        n = bins.size - 2
        if n < 1:
            return cls.none(bins)
        side, middle = HANN_SIDE
        weights = np.zeros((n, bins.size))
        row = np.arange(n)
        weights[row, row] = weights[row, row + 2] = side
        weights[row, row + 1] = middle
        return cls(weights / np.sqrt(2 * side**2 + middle**2), bins[1:-1])

    @classmethod
    def none(cls, bins: Floats) -> BinTaper:
        """Leave all bins as they are.

        Parameters
        ----------
        bins : ndarray of float64, shape (n_bins,)
        """
        return cls(np.eye(bins.size), bins)

    def at(self, rows: slice) -> BinTaper:
        """Some of the rows."""
        return BinTaper(self.weights[rows], self.bins[rows])

    @property
    def noise(self) -> Floats:
        """Covariance (n, n) of unit white noise in the rows."""
        return self.weights @ self.weights.T


@dataclass(frozen=True, eq=False)
class DirectionGrid:
    """Directions of a region and their steering vectors, and the array dimensions that hold them.

    Attributes
    ----------
    u, w : ndarray of float64, shapes (n_u,) and (n_w,)
        In Rayleigh cells.
    along_u, along_w : ndarray of float64
        Real steering vectors (n, size) in the bases of an `AtomMap`.
    """

    u: Floats
    w: Floats
    along_u: Floats
    along_w: Floats

    @classmethod
    def of(cls, reach: Reach) -> DirectionGrid:
        """Sample the directions of a region."""
        u, w = (
            np.linspace(
                *limits, max(int(np.ceil((limits[1] - limits[0]) / DIRECTION_STEP)) + 1, LEAST_DIRECTIONS)
            )
            for limits in reach.direction_limits
        )
        return cls(u, w, reach.atom_map.line(u, 2).value, reach.atom_map.line(w, 3).value)

    def sectors(self, cells: Complex, noise: Floats) -> Floats:
        """Learn which directions single cells show.

        Parameters
        ----------
        cells : ndarray of complex128, shape (n, size_u, size_w)
        noise : ndarray of float64, shape (n,)
            Noise powers of their elements.

        Returns
        -------
        ndarray of float64
            Powers (n, n_u, n_w) on every `SECTOR_STRIDE`-th direction.
        """
        into_u, into_w = (strong_dimensions(each, SECTOR_DIMENSION) for each in (self.along_u, self.along_w))
        dictionaries = self.along_u[::SECTOR_STRIDE] @ into_u, self.along_w[::SECTOR_STRIDE] @ into_w
        return learn_directions(dictionaries, into_u.T @ cells @ into_w, noise, SECTOR_STEPS)

    def grown(self, active: Mask, margin: float, is_box: bool) -> Mask:
        """Turn active directions of the sectors' grid into a mask of the fine grid, with a margin.

        Parameters
        ----------
        active : ndarray of bool
            On every `SECTOR_STRIDE`-th direction.
        margin : float
            Rayleigh cells.
        is_box : bool
            Take the whole box around all active directions' rows and columns.

        Returns
        -------
        ndarray of bool, shape (n_u, n_w)
        """
        if is_box:
            active = np.logical_and.outer(active.any(axis=1), active.any(axis=0))
        fine = np.zeros((self.u.size, self.w.size), dtype=np.bool_)
        fine[::SECTOR_STRIDE, ::SECTOR_STRIDE] = active
        reach = [
            int(np.ceil(margin / max(axis[1] - axis[0], margin / axis.size))) for axis in (self.u, self.w)
        ]
        return binary_dilation(fine, np.ones([2 * n + 1 for n in reach], dtype=np.bool_))


def strong_dimensions(dictionary: Floats, least: float) -> Floats:
    """Orthonormal basis (n, m) of the dimensions, one at least, in which a dictionary (n_atoms, n) is strong.

    A dimension counts from a singular value of `least`, relative to the largest.
    """
    strength, basis = _dimensions(dictionary)
    return basis[:, strength >= least]


def _dimensions(dictionary: Floats) -> tuple[Floats, Floats]:
    """Singular values (m,) of a dictionary over the largest, and its orthonormal dimensions (n, m)."""
    _, strength, directions = np.linalg.svd(dictionary, full_matrices=False)
    return strength / strength[0], directions.T


@dataclass(frozen=True, eq=False)
class MapTile:
    """A window of a map.

    Attributes
    ----------
    cells : ndarray of complex128, shape (r, d, size_u, size_w)
        Tapered rows.
    taper : BinTaper
        Of the rows, from the range bins of the map.
    doppler_bins : ndarray of float64, shape (v,)
        Places of the grid along Doppler.
    along_doppler : ndarray of float64, shape (v, d)
        Echoes of these lines in the tile.
    doppler_noise : ndarray of float64, shape (d, d)
        Covariance of unit noise along Doppler.
    directions : ndarray of bool, shape (n_u, n_w)
        Sectors, of a `DirectionGrid`.
    noise : float
        Noise power.
    """

    cells: Complex
    taper: BinTaper
    doppler_bins: Floats
    along_doppler: Floats
    doppler_noise: Floats
    directions: Mask
    noise: float


def learn_tile(
    tile: MapTile, grid: DirectionGrid, reach: Reach, least_dimension: float
) -> tuple[Floats, Floats]:
    """Learn the echoes of a tile: places (n, 4) in Rayleigh cells, and amplitudes (n,).

    Dimensions are kept from a singular value of `least_dimension`, relative to the largest.
    """
    first, last = tile.taper.bins[0] - RANGE_BEYOND_BINS, tile.taper.bins[-1] + RANGE_BEYOND_BINS
    range_bins = np.arange(first, last + 0.01, RANGE_STEP_BINS)
    at_u, at_w = np.nonzero(
        _thinned(tile.directions, MOST_ATOMS // (range_bins.size * tile.doppler_bins.size))
    )
    directions = (grid.along_u[at_u][:, :, None] * grid.along_w[at_w][:, None, :]).reshape(at_u.size, -1)
    into_doppler, into_direction = _most_dimensions(tile, directions, least_dimension)
    dictionaries = (
        reach.atom_map.line(range_bins, 0).value @ tile.taper.weights.T,
        tile.along_doppler @ into_doppler,
        directions @ into_direction,
    )
    allowed = _allowed(range_bins, grid.u[at_u], grid.w[at_w], reach)
    if not allowed.any():
        return np.empty((0, 4)), np.empty(0)
    in_directions = tile.cells.reshape(*tile.cells.shape[:2], -1) @ into_direction
    data = np.einsum("rdw,de->rew", in_directions, into_doppler)
    mean_power = float(np.mean(data.real**2 + data.imag**2))
    noise = Noise(
        max(tile.noise, mean_power * 10 ** (-MISFIT_DB / 10)),
        tile.taper.noise + LEAST_ENERGY * np.eye(tile.taper.bins.size),
        into_doppler.T @ tile.doppler_noise @ into_doppler,
    )
    first_power = _first_power(dictionaries, data) * allowed[:, None, :]
    amplitude = learn_grid(dictionaries, data, noise, first_power, GRID_STEPS)
    size = np.abs(amplitude)
    shown = np.flatnonzero(size > size.max() * 10 ** (-GRID_RANGE_DB / 20))
    strongest = shown[np.argsort(-size.ravel()[shown], kind="stable")[:MOST_MERGED_ATOMS]]
    at = np.unravel_index(strongest, size.shape)
    places = np.stack(
        [range_bins[at[0]], tile.doppler_bins[at[1]], grid.u[at_u[at[2]]], grid.w[at_w[at[2]]]], axis=1
    )
    return merge_neighbours(places, amplitude[at], NEIGHBOUR_BOX)


def _thinned(directions: Mask, most: int) -> Mask:
    """Every second direction along u and w, or every fourth, ..., until there are at most so many."""
    stride, thinned = 1, directions
    while np.count_nonzero(thinned) > max(most, 1):
        stride *= 2
        thinned = np.zeros_like(directions)
        thinned[::stride, ::stride] = directions[::stride, ::stride]
    return thinned if thinned.any() else directions


def _most_dimensions(tile: MapTile, directions: Floats, least: float) -> tuple[Floats, Floats]:
    """Bases of the strong dimensions along Doppler and of the directions: as many as the tile may have."""
    n_doppler = tile.cells.shape[1]
    is_line = tile.doppler_bins.size == 1
    along_doppler = (np.ones(n_doppler), np.eye(n_doppler)) if is_line else _dimensions(tile.along_doppler)
    across = _dimensions(directions)
    while True:
        into_doppler, into_direction = (
            basis[:, strength >= least] for strength, basis in (along_doppler, across)
        )
        n_others = into_direction.shape[1] * into_doppler.shape[1]
        if tile.taper.bins.size * n_others <= MOST_DIMENSIONS or least == 1:
            return into_doppler, into_direction
        least = min(2 * least, 1.0)


def _allowed(range_bins: Floats, u: Floats, w: Floats, reach: Reach) -> Mask:
    """Places (range, direction) of a grid from which echoes can come."""
    n_range, n = range_bins.size, u.size
    places = np.zeros((n_range, n, 4))
    places[..., 0], places[..., 2], places[..., 3] = range_bins[:, None], u, w
    return reach.contains(places.reshape(-1, 4)).reshape(n_range, n)


def _first_power(dictionaries: tuple[Floats, Floats, Floats], data: Complex) -> Floats:
    """Powers of a matched filter, but not of atoms that hardly show."""
    along_range, along_doppler, _ = (np.sum(each**2, axis=1) for each in dictionaries)
    # The directions are not tapered: steering vectors are of unit energy but for what is left out.
    energy = np.multiply.outer(along_range, along_doppler)[:, :, None]
    power: Floats = np.abs(matched(dictionaries, data)) ** 2
    power *= FIRST_SHARE / np.maximum(energy, LEAST_ENERGY * energy.max()) ** 2
    return power


def within_dynamic_range(places: Floats, strength: Floats) -> Mask:
    """Tell which atoms of a tile are no misfit of stronger ones nearby."""
    return strength > strongest_near(places, strength, NEAR_BINS) * 10 ** (-DYNAMIC_RANGE_DB / 20)
