"""Echoes as atoms with four coordinates, and their products with a gated map and with each other.

An atom is the echo of one scatterer, scaled to unit energy. Its place is given
in Rayleigh cells along range, Doppler, u and w: bins, and 2/P and 2/Q of
direction cosine. Along each coordinate it is a wave over an aperture, and all
apertures are referred to their middle here. Then an atom is orthogonal to its
own slopes, and all products between atoms and slopes are real, so that joint
fits of many atoms cost a few real matrices of their number squared.

Even the atoms are real: behind the transforms along range and Doppler they are
real kernels, and steering vectors become real by a unitary transform that
mixes each element with its mirror image. Where the directions are known to lie
between limits, the few dimensions that such steering vectors span are all that
is kept of the array.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from isacbench.checked_arrays import Complex, Floats
from isacbench.dsp.bursts import SymbolBursts, whole_frame
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.model.kernels import sine_cosine
from isacbench.model.numerology import System
from isacbench.model.region import Interval

N_COORDINATES = 4
"""Range, Doppler, u and w, in this order everywhere."""

MARGIN_CELLS = 1.0
"""Rayleigh cells beyond the limits of u and w in which steering vectors are kept."""

NEGLIGIBLE = 1e-3
"""Singular value, relative to the largest, below which a dimension of the steering vectors is left out."""

STEERING_SAMPLES = 8
"""Steering vectors a Rayleigh cell from which their dimensions are found."""


class AtomFactors(NamedTuple):
    """Factors of n atoms along one coordinate and their derivatives by the place, each (n, size)."""

    value: Floats
    slope: Floats
    curvature: Floats


Lines = tuple[AtomFactors, ...]
"""Factors of atoms along range, Doppler, u and w."""


class Correlations:
    """Products of n atoms and of their slopes with a map; of the slopes once they are asked for.

    Parameters
    ----------
    value : ndarray of complex128, shape (n,)
        Outputs of the matched filters.
    slopes : callable
        Gives `slope`.
    """

    def __init__(self, value: Complex, slopes: Callable[[], Complex]) -> None:
        self.value, self._slopes = value, slopes

    @cached_property
    def slope(self) -> Complex:
        """The same (n, 4) of the first derivatives along each coordinate, per Rayleigh cell."""
        return self._slopes()


class LineProducts(NamedTuple):
    """Real products of n atoms with m atoms along one coordinate, each of shape (n, m).

    Attributes
    ----------
    value : ndarray of float64
        Products of the atoms.
    slope : ndarray of float64
        Products of the first ones with the slopes of the second ones.
    slopes : ndarray of float64
        Products of both slopes.
    """

    value: Floats
    slope: Floats
    slopes: Floats


@dataclass(frozen=True, eq=False)
class AtomMap:
    """A gated map in which all atoms are real.

    Attributes
    ----------
    cells : ndarray of complex128, shape (n_range, n_doppler, n_u, n_w)
        Apertures referred to their middle, the array in its bases; over
        `bin_gain`, so that noise is white in what the atoms span.
    range_bins, doppler_bins : ndarray of float64
        Bins of the first two axes.
    n_subcarriers : int
        Length of the transform that the range bins come from.
    bursts : SymbolBursts
        What the Doppler bins come from.
    bases : (ndarray of float64, ndarray of float64), shapes (P, n_u) and (Q, n_w)
        Orthonormal, of the real steering vectors along u and w.
    """

    cells: Complex
    range_bins: Floats
    doppler_bins: Floats
    n_subcarriers: int
    bursts: SymbolBursts
    bases: tuple[Floats, Floats]

    @classmethod
    def from_map(
        cls, gated: GatedMap, system: System, cosine_limits: tuple[Interval, Interval] | None = None
    ) -> AtomMap:
        """Refer an untapered map to the middle of its apertures.

        Parameters
        ----------
        cosine_limits : (Interval, Interval), optional
            Lowest and highest u, and w, between which echoes are of interest;
            the rest of the array's dimensions is left out.
        """
        n_c, n_s = system.n_subcarriers, system.n_symbols
        rows, columns = gated.gate.range_bins, gated.gate.doppler_bins
        along_range = np.exp(-1j * np.pi * (n_c - 1) / n_c * rows)
        bursts = gated.doppler_kernel(n_s)
        along_doppler = np.exp(1j * np.pi * (n_s - 1) / n_s * columns) / np.sqrt(bursts.redundancy)
        n_p, n_q = gated.cells.shape[2:]
        limits = (None, None) if cosine_limits is None else cosine_limits
        bases = _steering_basis(n_p, limits[0]), _steering_basis(n_q, limits[1])
        into_u, into_w = (basis.T @ _mirror_transform(len(basis)) for basis in bases)
        cells = into_u @ (gated.cells @ into_w.T)
        cells *= np.multiply.outer(along_range, along_doppler)[:, :, None, None]
        return cls(cells, rows.astype(np.float64), columns.astype(np.float64), n_c, bursts, bases)

    @property
    def array_shape(self) -> tuple[int, int]:
        """Virtual elements (P, Q)."""
        return len(self.bases[0]), len(self.bases[1])

    @property
    def bin_gain(self) -> float:
        """Amplitude of an atom's matched filter over what the cell holds that the atom peaks in.

        1 of a whole frame. Where Doppler bins outnumber the symbols, an atom's
        energy is spread over several of them.
        """
        return float(np.sqrt(self.bursts.redundancy))

    @property
    def cell_size(self) -> Floats:
        """Rayleigh cell in range bins, Doppler bins, u and w, shape (4,)."""
        n_p, n_q = self.array_shape
        return np.array([1.0, 1.0, 2 / n_p, 2 / n_q])

    @property
    def periods(self) -> Floats:
        """Rayleigh cells along each coordinate after which an atom is the same but for its sign, (4,)."""
        return np.array([self.n_subcarriers, self.bursts.n_symbols, *self.array_shape], dtype=np.float64)

    def line(self, places: Floats, axis: int) -> AtomFactors:
        """Factors of atoms along one coordinate.

        Parameters
        ----------
        places : ndarray of float64, shape (n,)
            Along that coordinate, in Rayleigh cells.
        axis : int
            0 to 3 for range, Doppler, u and w.
        """
        return AtomFactors(*self._factors(places, axis, 2))

    def factors(self, places: Floats, axis: int) -> Floats:
        """Factors of atoms along one coordinate as of `line`, without derivatives, (n, size)."""
        return self._factors(places, axis, 0)[0]

    def _factors(self, places: Floats, axis: int, order: int) -> tuple[Floats, ...]:
        """Factors of atoms along one coordinate, and their derivatives up to an order (0 or 2)."""
        if axis > 1:
            basis = self.bases[axis - 2]
            return tuple(factor @ basis for factor in _real_steering(len(basis), places)[: order + 1])
        bins = (self.range_bins, self.doppler_bins)[axis]
        kernel = (whole_frame(self.n_subcarriers), self.bursts)[axis]
        slopes = kernel.slopes(places[:, None] - bins, order)
        return tuple(slope / np.sqrt(kernel.redundancy) for slope in slopes)

    def lines(self, places: Floats) -> Lines:
        """Factors of atoms along range, Doppler, u and w.

        Parameters
        ----------
        places : ndarray of float64, shape (n, 4)
        """
        return tuple(self.line(places[:, axis], axis) for axis in range(N_COORDINATES))

    @property
    def energy(self) -> float:
        """Of all cells."""
        return float(np.vdot(self._real_rows, self._real_rows))

    def without(self, lines: Lines, amplitude: Complex) -> AtomMap:
        """The map less the echoes of atoms.

        Parameters
        ----------
        lines : tuple of AtomFactors
            From `lines`.
        amplitude : ndarray of complex128, shape (n,)
            Of the unit-energy atoms.
        """
        return replace(self, cells=self.cells - sum_of_echoes(amplitude, *(line.value for line in lines)))

    def along(self, basis: Floats) -> AtomMap:
        """The map in the dimensions along range that a basis (n_range, d) spans, for factors times it."""
        cells = (basis.T @ self._real_rows).view(np.complex128)
        return replace(self, cells=cells.reshape(-1, *self.cells.shape[1:]))

    def ranges(self, factors: Floats) -> Floats:
        """Products (n, n_doppler, n_u n_w 2) of factors (n, n_range) with the map, its parts side by side."""
        return (factors @ self._real_rows).reshape(
            len(factors), self.doppler_bins.size, 2 * self.cells[0, 0].size
        )

    def matched_separably(self, factors: list[Floats]) -> Complex:
        """Products (r, d, g, h) with atoms at all combinations of factors (r, n_range), (d, n_doppler) ..."""
        along_range, along_doppler, along_u, along_w = factors
        rows = self._real_rows.reshape(len(self.cells), self.doppler_bins.size, -1)
        seen = (along_doppler @ rows).reshape(len(rows), -1)
        shape = len(along_range), len(along_doppler), *self.cells.shape[2:]
        snapshots = (along_range @ seen).view(np.complex128)
        return np.asarray(along_u @ (snapshots.reshape(shape) @ along_w.T), dtype=np.complex128)

    def correlate(self, lines: Lines) -> Correlations:
        """Products of atoms (from `lines`), and of their slopes, with the map."""
        along_range, along_doppler, along_u, along_w = lines
        seen = self._snapshots(along_range.value, along_doppler.value, along_doppler.slope)
        value = np.einsum("nu,nu->n", (seen[:, 0] @ along_w.value[:, :, None])[:, :, 0], along_u.value)
        return Correlations(value, lambda: self._derivatives(lines, 1, seen))

    def correlate_curvatures(self, lines: Lines) -> Complex:
        """Products (n, 4) of the second derivatives of atoms along each coordinate with the map."""
        along_range, along_doppler, *_ = lines
        seen = self._snapshots(along_range.value, along_doppler.value, along_doppler.curvature)
        return self._derivatives(lines, 2, seen)

    def products(self, lines: Lines) -> tuple[LineProducts, ...]:
        """Products of atoms with each other along the four coordinates.

        Parameters
        ----------
        lines : tuple of AtomFactors
            From `lines`.

        Returns
        -------
        tuple of LineProducts
            For range, Doppler, u and w, as the gate and the array see them.
        """
        return tuple(
            LineProducts(value @ value.T, value @ slope.T, slope @ slope.T) for value, slope, _ in lines
        )

    def _snapshots(self, along_range: Floats, *along_doppler: Floats) -> Complex:
        """Array snapshots (n, k, n_u, n_w) that factors along range and k factors along Doppler see."""
        seen = np.stack(along_doppler, axis=1) @ self.ranges(along_range)
        return seen.view(np.complex128).reshape(*seen.shape[:2], *self.cells.shape[2:])

    def _derivatives(self, lines: Lines, order: int, seen: Complex) -> Complex:
        """Products (n, 4) of derivatives of atoms with the map; `seen` holds those along Doppler."""
        along_range, along_doppler, along_u, along_w = lines
        across = self._snapshots(along_range[order], along_doppler.value)
        beams = np.einsum("nsuw,nw->nsu", np.concatenate([across, seen], axis=1), along_w.value)
        output = np.einsum("nsu,nu->ns", beams, along_u.value)
        turned_u = np.einsum("nu,nu->n", beams[:, 1], along_u[order])
        turned_w = np.einsum("nuw,nu,nw->n", seen[:, 0], along_u.value, along_w[order])
        return np.stack([output[:, 0], output[:, 2], turned_u, turned_w], axis=1)

    @cached_property
    def _real_rows(self) -> Floats:
        """The map as real rows, one a range bin: the kernels are real, and so is the product with them."""
        rows = np.ascontiguousarray(self.cells).reshape(len(self.cells), -1)
        return rows.view(np.float64)


def sum_of_echoes(
    amplitude: Complex, along_range: Floats, along_doppler: Floats, along_u: Floats, along_w: Floats
) -> Complex:
    """Sum (r, d, g, h) of n echoes of amplitudes (n,) with the factors (n, r), (n, d), (n, g) and (n, h)."""
    directions = amplitude[:, None, None] * along_u[:, :, None] * along_w[:, None]
    bins = along_range[:, :, None] * along_doppler[:, None]
    # All factors but the amplitudes are real: so is the product, of real and imaginary parts side by side.
    return np.tensordot(bins, directions.view(np.float64), (0, 0)).view(np.complex128)


def _mirror_transform(n: int) -> Complex:
    """Unitary transform (n, n) that turns exp(jx), odd in x over the elements, into cos x + sin x."""
    identity = np.eye(n)
    # A product that numpy's types take for real, though it is not.
    return np.add((0.5 - 0.5j) * identity, (0.5 + 0.5j) * identity[::-1], dtype=np.complex128)


def _real_steering(n: int, places: Floats) -> AtomFactors:
    """Unit-energy steering vectors (k, n) behind `_mirror_transform`, and their derivatives per cell."""
    rate = -2 * np.pi / n * (np.arange(n) - (n - 1) / 2)
    phase = np.multiply.outer(places, rate)
    sine, cosine = sine_cosine(phase)
    value = (cosine + sine) / np.sqrt(n)
    return AtomFactors(value, rate / np.sqrt(n) * (cosine - sine), -(rate**2) * value)


def _steering_basis(n: int, limits: Interval | None) -> Floats:
    """Orthonormal basis (n, m) of the real steering vectors between two cosines and a little beyond."""
    if limits is None:
        return np.eye(n)
    lower, upper = (n / 2 * limits[0] - MARGIN_CELLS, n / 2 * limits[1] + MARGIN_CELLS)
    places = np.linspace(lower, upper, int(np.ceil(STEERING_SAMPLES * (upper - lower))))
    _, strength, directions = np.linalg.svd(_real_steering(n, places).value, full_matrices=False)
    return directions[strength > NEGLIGIBLE * strength[0]].T


def product_matrix(lines: tuple[LineProducts, ...], left: int | None, right: int | None) -> Floats:
    """Products (n, n) of n atoms, from `AtomMap.products`.

    The left and the right factor are the atoms themselves (None) or their slopes along a coordinate.
    """
    matrix = np.ones_like(lines[0].value)
    for axis, (value, slope, slopes) in enumerate(lines):
        if axis == left:
            matrix *= slopes if axis == right else slope.T
        else:
            matrix *= slope if axis == right else value
    return matrix
