"""Inner products of echoes and of their slopes, from sums along one axis each.

An echo is a wave exp(jψ), ψ linear in the parameters. All inner products of
echoes and of their slopes are sums x^a exp(jxΔ) along one axis (a = 0, 1, 2),
multiplied over the axes: neither the grid nor the array is ever filled.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from isacbench.checked_arrays import Complex, Floats
from isacbench.choices import Sensing
from isacbench.errors import require
from isacbench.model.numerology import System
from isacbench.model.prs import resource_elements

N_PARAMETERS = 4


class EchoSlopes:
    """Samples of an echo: phase slopes per bin along four axes, from their centroids.

    With the centroid as the origin, amplitudes are those at the middle of the
    aperture. That leaves the bound as it is and keeps sums free of
    cancellation. Resource elements are a union of products of subcarriers and
    symbols: one for the full grid, one for each comb offset of the PRS.

    Attributes
    ----------
    units : ndarray, shape (4,)
        Range bin, velocity bin, 1 and 1.
    blocks : list of (ndarray, ndarray)
        Slopes along subcarriers and symbols of each product.
    along_u, along_w : ndarray
        Slopes of the elements.
    reference : ndarray, shape (4,)
        Slopes of the centroid itself, seen from element (0, 0) on subcarrier 0 and symbol 0.
    """

    def __init__(self, system: System, array_shape: tuple[int, int], sensing: Sensing) -> None:
        mask = resource_elements(system, sensing)
        n_c, n_s = mask.shape
        n_p, n_q = array_shape
        require(min(array_shape) >= 2, "array_shape", array_shape, "2 elements and more along u and w")
        along_range, along_doppler = -2 * np.pi / n_c * np.arange(n_c), 2 * np.pi / n_s * np.arange(n_s)
        along_u, along_w = -np.pi * np.arange(n_p), -np.pi * np.arange(n_q)
        share = mask / max(mask.sum(), 1)
        centroid = (
            np.sum(share.T @ along_range),
            np.sum(share @ along_doppler),
            along_u.mean(),
            along_w.mean(),
        )
        self.reference = np.array(centroid)
        self.units = np.array([system.range_bin_m, system.velocity_bin_mps, 1.0, 1.0])
        along_range, along_doppler = along_range - centroid[0], along_doppler - centroid[1]
        self.along_u, self.along_w = along_u - centroid[2], along_w - centroid[3]
        combs, comb_of_symbol = np.unique(mask, axis=1, return_inverse=True)
        self.blocks = [
            (along_range[comb], along_doppler[comb_of_symbol == i])
            for i, comb in enumerate(combs.T)
            if comb.any()
        ]
        determined = self.blocks and np.linalg.matrix_rank(self.moments(), hermitian=True) > N_PARAMETERS
        allowed = f"subcarriers and symbols whose sensed elements ({sensing!r}) determine range and velocity"
        require(bool(determined), "system", system, allowed)

    def in_units(
        self, shape: tuple[int, ...], range_m: ArrayLike, velocity_mps: ArrayLike, u: ArrayLike, w: ArrayLike
    ) -> Floats:
        """Convert places to range bins, velocity bins, u and w.

        Parameters
        ----------
        shape : tuple of int
            Of the amplitudes, to be (K,).
        range_m, velocity_mps, u, w : array_like, shape (K,)

        Returns
        -------
        ndarray of float64, shape (4, K)

        Raises
        ------
        InputError
            If there are not as many places as amplitudes, or they are not finite.
        """
        places = {"range_m": range_m, "velocity_mps": velocity_mps, "u": u, "w": w}
        for name, values in places.items():
            same = len(shape) == 1 and shape[0] > 0 and np.shape(values) == shape
            require(same and bool(np.all(np.isfinite(values))), name, values, "as many as amplitudes, finite")
        return np.array(list(places.values()), dtype=np.float64) / self.units[:, None]

    def moments(self) -> Floats:
        """Sum the products of 1 and the four slopes over all elements.

        Returns
        -------
        ndarray of float64, shape (5, 5)
        """
        gram = self.gram(np.zeros((N_PARAMETERS, 1)))
        return np.asarray(gram[:, :, 0, 0].real, dtype=np.float64)

    def gram(self, places: Floats) -> Complex:
        """Multiply echoes of amplitude 1, and these times each slope, with each other.

        Parameters
        ----------
        places : ndarray, shape (4, K)
            In range bins, velocity bins, u and w.

        Returns
        -------
        ndarray of complex128, shape (5, 5, K, K)
        """
        # Only differences of places count; small ones keep their digits.
        range_bin, doppler_bin, u, w = places - places.mean(axis=1, keepdims=True)
        delay_doppler: dict[tuple[int, int], Complex] = {}
        for along_range, along_doppler in self.blocks:
            delay, doppler = _axis_sums(range_bin, along_range), _axis_sums(doppler_bin, along_doppler)
            for i, j in ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)):
                delay_doppler[i, j] = delay_doppler.get((i, j), 0) + delay[i] * doppler[j]
        over_u, over_w = _axis_sums(u, self.along_u), _axis_sums(w, self.along_w)
        # A row's and a column's powers of the four slopes add up.
        powers = np.eye(N_PARAMETERS + 1, N_PARAMETERS, k=-1, dtype=np.int64)
        gram = np.empty((N_PARAMETERS + 1, N_PARAMETERS + 1, *over_u.shape[1:]), dtype=np.complex128)
        for i, j in np.ndindex(gram.shape[:2]):
            in_range, in_doppler, in_u, in_w = (int(power) for power in powers[i] + powers[j])
            gram[i, j] = delay_doppler[in_range, in_doppler] * over_u[in_u] * over_w[in_w]
        return gram


@lru_cache(maxsize=8)
def echo_slopes(system: System, array_shape: tuple[int, int], sensing: Sensing) -> EchoSlopes:
    """Prepare the slopes of all sensed elements; those of the last few calls are kept.

    Parameters
    ----------
    array_shape : (int, int)
        Virtual elements (P, Q), at least 2 each.
    sensing : {"all", "prs"}

    Raises
    ------
    InputError
        If the elements do not determine all four parameters of a scatterer alone.
    """
    return EchoSlopes(system, array_shape, sensing)


def _axis_sums(places: Floats, slopes: Floats) -> Complex:
    """Sums (3, K, K) of x^a exp(jx (place_l - place_k)) over the slopes x, a = 0, 1, 2."""
    waves = np.exp(1j * np.multiply.outer(places, slopes))
    return np.stack([(waves.conj() * slopes**power) @ waves.T for power in range(3)])
