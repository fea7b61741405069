"""Echoes as atoms with four coordinates, and their products with a gated map and with each other.

An atom is the echo of one scatterer, scaled to unit energy. Its place is given
in Rayleigh cells along range, Doppler, u and w: bins, and 2/P and 2/Q of
direction cosine. Along each coordinate it is a wave over an aperture, and all
apertures are referred to their middle here. Then an atom is orthogonal to its
own slopes, and all products between atoms and slopes are real, so that joint
fits of many atoms cost a few real matrices of their number squared.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from isacbench.dsp.kernels import dirichlet_slopes
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.model.numerology import System

__all__ = ["N_COORDINATES", "AtomMap", "Correlations", "LineProducts", "product_matrix"]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

N_COORDINATES = 4
"""Range, Doppler, u and w, in this order everywhere."""


@dataclass(frozen=True, eq=False)
class Correlations:
    """Products of n atoms and of their derivatives with a map.

    Attributes
    ----------
    value : ndarray of complex128, shape (n,)
        Outputs of the matched filters.
    slope, curvature : ndarray of complex128, shape (n, 4)
        The same of the first and of the second derivatives along each
        coordinate, per Rayleigh cell.
    """

    value: Complex
    slope: Complex
    curvature: Complex

    def select(self, keep: NDArray[np.bool_]) -> Correlations:
        """Copies of those of some atoms."""
        return Correlations(self.value[keep], self.slope[keep], self.curvature[keep])


@dataclass(frozen=True, eq=False)
class LineProducts:
    """Real products of n atoms with m atoms along one coordinate, each of shape (n, m).

    Attributes
    ----------
    value : ndarray of float64
        Of the atoms.
    slope : ndarray of float64
        Of the first ones with the slopes of the second ones.
    slopes : ndarray of float64
        Of both slopes.
    """

    value: Floats
    slope: Floats
    slopes: Floats


@dataclass(frozen=True, eq=False)
class AtomMap:
    """A gated map, its apertures referred to their middle.

    Attributes
    ----------
    cells : ndarray of complex128, shape (n_range, n_doppler, P, Q)
    range_bins, doppler_bins : ndarray of float64
        Bins of the first two axes.
    n_subcarriers, n_symbols : int
        Lengths of the transforms that the bins come from.
    """

    cells: Complex
    range_bins: Floats
    doppler_bins: Floats
    n_subcarriers: int
    n_symbols: int

    @classmethod
    def from_map(cls, gated: GatedMap, system: System) -> AtomMap:
        """Refer an untapered map to the middle of its apertures.

        Parameters
        ----------
        gated : GatedMap
        system : System

        Returns
        -------
        AtomMap
        """
        n_c, n_s = system.n_subcarriers, system.n_symbols
        rows, columns = gated.gate.range_bins, gated.gate.doppler_bins
        along_range = np.exp(-1j * np.pi * (n_c - 1) / n_c * rows)
        along_doppler = np.exp(1j * np.pi * (n_s - 1) / n_s * columns)
        cells = gated.cells * np.multiply.outer(along_range, along_doppler)[:, :, None, None]
        return cls(cells, rows.astype(np.float64), columns.astype(np.float64), n_c, n_s)

    @property
    def array_shape(self) -> tuple[int, int]:
        """Virtual elements (P, Q)."""
        return self.cells.shape[2], self.cells.shape[3]

    @property
    def cell_size(self) -> Floats:
        """Rayleigh cell in range bins, Doppler bins, u and w, shape (4,)."""
        n_p, n_q = self.array_shape
        return np.array([1.0, 1.0, 2 / n_p, 2 / n_q])

    def lines(self, places: Floats) -> tuple[tuple[Floats, Floats, Floats], ...]:
        """Kernels over the bins, with both derivatives, along range and along Doppler.

        Parameters
        ----------
        places : ndarray of float64, shape (n, 4)

        Returns
        -------
        tuple
            For range and for Doppler three arrays (n, bins).
        """
        return (
            dirichlet_slopes(self.range_bins - places[:, :1], self.n_subcarriers),
            dirichlet_slopes(self.doppler_bins - places[:, 1:2], self.n_symbols),
        )

    def beams(self, places: Floats, axis: int) -> tuple[Complex, Floats]:
        """Unit-energy steering vectors along u (axis 2) or w (axis 3), and their phase slopes.

        Parameters
        ----------
        places : ndarray of float64, shape (n,)
            In Rayleigh cells.
        axis : int

        Returns
        -------
        vectors : ndarray of complex128, shape (n, elements)
        slope : ndarray of float64, shape (elements,)
            Phase per Rayleigh cell; the derivative of a vector is j times
            this times the vector.
        """
        n = self.cells.shape[axis]
        slope = -2 * np.pi / n * (np.arange(n) - (n - 1) / 2)
        return np.exp(1j * np.multiply.outer(places, slope)) / np.sqrt(n), slope

    def correlate(self, places: Floats, curvatures: bool = False) -> Correlations:
        """Products of atoms, and of their derivatives, with the map.

        Parameters
        ----------
        places : ndarray of float64, shape (n, 4)
        curvatures : bool, default False
            Whether second derivatives are wanted; without, they are NaN.

        Returns
        -------
        Correlations
        """
        n, n_doppler = len(places), self.doppler_bins.size
        along_range, along_doppler = self.lines(places)
        n_orders = 3 if curvatures else 2
        # Kernels of place minus bin: odd derivatives change sign.
        rows = np.concatenate([along_range[0], -along_range[1], along_range[2]][:n_orders])
        columns = along_doppler[0], -along_doppler[1], along_doppler[2]
        lines = (rows @ self._real_rows).view(np.complex128).reshape(n_orders, n, n_doppler, -1)

        def snapshot(range_order: int, doppler_order: int) -> Complex:
            line: Complex = columns[doppler_order][:, None, :] @ lines[range_order]
            return line.reshape(n, *self.array_shape)

        a, slope_u = self.beams(places[:, 2], 2)
        b, slope_w = self.beams(places[:, 3], 3)

        def beam(snapshots: Complex, u_order: int = 0, w_order: int = 0) -> Complex:
            left, right = a.conj() * (-1j * slope_u) ** u_order, b.conj() * (-1j * slope_w) ** w_order
            output: Complex = np.sum(left * (snapshots @ right[:, :, None])[:, :, 0], axis=1)
            return output

        own = snapshot(0, 0)

        def derivative(order: int) -> Complex:
            along = beam(snapshot(order, 0)), beam(snapshot(0, order)), beam(own, order), beam(own, 0, order)
            return np.stack(along, axis=1)

        curvature = derivative(2) if curvatures else np.full((n, N_COORDINATES), np.nan, dtype=np.complex128)
        return Correlations(beam(own), derivative(1), curvature)

    def products(self, places: Floats) -> tuple[LineProducts, ...]:
        """Products of atoms with each other along the four coordinates.

        Parameters
        ----------
        places : ndarray of float64, shape (n, 4)

        Returns
        -------
        tuple of LineProducts
            For range, Doppler, u and w, as the gate and the array see them.
        """
        lines = [
            LineProducts(value @ value.T, -value @ slope.T, slope @ slope.T)
            for value, slope, _ in self.lines(places)
        ]
        for axis in (2, 3):
            vectors, slope = self.beams(places[:, axis], axis)
            turned = 1j * slope * vectors
            lines.append(
                LineProducts(
                    (vectors.conj() @ vectors.T).real,
                    (vectors.conj() @ turned.T).real,
                    (turned.conj() @ turned.T).real,
                )
            )
        return tuple(lines)

    def curvature_products(self, places: Floats) -> tuple[tuple[Floats, Floats], ...]:
        """Products of the second derivatives of atoms along each coordinate.

        Parameters
        ----------
        places : ndarray of float64, shape (n, 4)

        Returns
        -------
        tuple of (ndarray of float64, ndarray of float64)
            For range, Doppler, u and w: products (n, n) with the atoms
            themselves along that coordinate, and energies (n,).
        """
        lines = [
            (curvature @ value.T, np.sum(curvature**2, axis=1)) for value, _, curvature in self.lines(places)
        ]
        for axis in (2, 3):
            vectors, slope = self.beams(places[:, axis], axis)
            curved = -(slope**2) * vectors
            lines.append(((curved.conj() @ vectors.T).real, np.sum(np.abs(curved) ** 2, axis=1)))
        return tuple(lines)

    @cached_property
    def _real_rows(self) -> Floats:
        """The map as real rows, one a range bin: the kernels are real, and so is the product with them."""
        rows = np.ascontiguousarray(self.cells).reshape(self.range_bins.size, -1)
        return rows.view(np.float64)


def product_matrix(lines: tuple[LineProducts, ...], left: int | None, right: int | None) -> Floats:
    """Products of n atoms, or of their slopes along one coordinate each.

    Parameters
    ----------
    lines : tuple of LineProducts
        From `AtomMap.products`.
    left, right : int or None
        Coordinate along which the left and the right factor are derived, None
        for the atoms themselves.

    Returns
    -------
    ndarray of float64, shape (n, n)
    """
    matrix = np.ones_like(lines[0].value)
    for axis, line in enumerate(lines):
        if left == axis and right == axis:
            matrix *= line.slopes
        elif right == axis:
            matrix *= line.slope
        elif left == axis:
            matrix *= line.slope.T
        else:
            matrix *= line.value
    return matrix
