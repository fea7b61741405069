"""Tapers that act on the bins of a transform, with the noise that they correlate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from isacbench.checked_arrays import Floats

HANN_SIDE = 0.25, 0.5
"""Weights of the neighbouring bins and of the middle one: a Hann window over the apertures of an `AtomMap`,
whose kernels are referred to their middle and therefore add up with equal signs."""


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

    def noise(self, rows: slice) -> Floats:
        """Covariance of unit white noise in some rows.

        Returns
        -------
        ndarray of float64, shape (n, n)
        """
        weights = self.weights[rows]
        return weights @ weights.T
