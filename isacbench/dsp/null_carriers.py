"""Null carriers: what subcarriers without a transmitted symbol would have held, from those around them."""

from __future__ import annotations

from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isacbench.checked_arrays import Complex, Floats, Mask, checked_array
from isacbench.model.region import Interval

NEAR_CARRIERS = 32
"""Distance of the carriers from which null carriers are interpolated."""

NEAR_OFFSETS = np.arange(-NEAR_CARRIERS, NEAR_CARRIERS + 1)

OWN_SIGNAL_BINS = 2
"""Ranges from -2 to 2 bins, in which the transmitter's own signal is received."""

OWN_SIGNAL = 10.0
"""Amplitude of that signal over echoes from beyond the region."""

FARTHEST = 0.75
"""Farthest echoes that are expected, over the unambiguous range."""

EXPECTED = (
    *((share, 1e-3) for share in (1.0, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001, 0.0)),
    *((0.0, noise) for noise in (0.01, 0.1, 1.0)),
)
"""Choices of the power of echoes from beyond the region, and of noise, over that of the region's."""

UNKNOWN = 1e9
"""Power of noise in carriers that are null, too."""

MISSED = 10 ** (-45 / 20)
"""Amplitude that may be left of an echo from the region."""

ABOUT = 1.4
"""Ratio up to which more is about as much."""

MOST_NOISE = 0.6
"""Power of the noise that null carriers get, over that of the noise of all carriers: 2 dB more noise."""


class NullCarriers(NamedTuple):
    """Linear estimate of what null carriers would have held, from the carriers around them.

    Attributes
    ----------
    used : ndarray of bool, shape (n_subcarriers,)
        False for null carriers. The band reaches from the first that is used to the last.
    null : ndarray of int, shape (n_null,)
        Null carriers within the band, counted in it.
    weights : ndarray of complex128, shape (n_null, 2 NEAR_CARRIERS + 1)
        Of the carriers around each.
    missed : float
        Most that the estimate leaves of an echo from the region in other range
        bins, in amplitude over that of the echo.
    missed_beyond : float
        The same of an echo from up to `FARTHEST` of the unambiguous range.
    """

    used: Mask
    null: NDArray[np.intp]
    weights: Complex
    missed: float
    missed_beyond: float

    def interpolated(self, rows: Complex) -> Complex:
        """Estimate null carriers within a transform.

        Parameters
        ----------
        rows : ndarray of complex128, shape (r, n_band)
            Of the transform over the band, from `range_rows`.

        Returns
        -------
        ndarray of complex128, shape (r, n_subcarriers)
            Over all carriers; 0 for those that are not used.
        """
        of_all = np.zeros((len(rows), self.used.size), dtype=np.complex128)
        of_band = of_all[:, used_band(self.used)]
        of_band[...] = rows
        for offset, weights in zip(NEAR_OFFSETS, self.weights.T, strict=True):
            there = np.flatnonzero(weights)
            of_band[:, self.null[there] + offset] += rows[:, self.null[there]] * weights[there]
        return of_all * self.used

    def missed_at(self, range_bins: ArrayLike) -> Floats:
        """Bound the amplitude that the estimate leaves of echoes in range bins of the band, over theirs."""
        band = self.used[used_band(self.used)]
        return _missed(self.weights, np.ones(self.null.size), checked_array("bins", range_bins), band.size)


def interpolate_nulls(used: Mask, limits: Interval) -> NullCarriers:
    """Estimate what null carriers within a band would have held from the carriers around them.

    Echoes between two limits of range change slowly from one subcarrier to the
    next. So the linear estimate of least mean square error tells what a null
    carrier, such as that at DC, would have held. In a long run of them it tells less.
    The estimate depends on how strong the transmitter's own signal at range 0,
    echoes from beyond the region, and noise are expected to be. Of some
    choices that tell echoes from the region well enough, or about as well as
    any, the one is taken that leaves least of echoes from beyond the region
    for the noise that it adds.

    Parameters
    ----------
    used : ndarray of bool, shape (n_subcarriers,)
        False for null carriers.
    limits : (float, float)
        Lowest and highest range in bins of the band.

    References
    ----------
    Kay, "Fundamentals of Statistical Signal Processing: Estimation Theory"
    (1993), chapter 12.
    """
    band = used[used_band(used)]
    n, null = band.size, np.flatnonzero(~band)
    near = null[:, None] + NEAR_OFFSETS
    is_known = (near >= 0) & (near < n) & band[near.clip(0, n - 1)]
    # Null carriers with the same carriers around them have the same weights.
    patterns, pattern = np.unique(is_known, axis=0, return_inverse=True)
    counts = np.bincount(pattern.ravel(), minlength=len(patterns))
    turns = np.subtract.outer(NEAR_OFFSETS, NEAR_OFFSETS) / n

    def covariance(lower: float, upper: float) -> Complex:
        """Covariance of the carriers around another, of echoes between two ranges in bins."""
        values: Complex = np.exp(-1j * np.pi * (lower + upper) * turns)
        return values * np.sinc((upper - lower) * turns)

    region, own = covariance(*limits), covariance(-OWN_SIGNAL_BINS, OWN_SIGNAL_BINS)
    beyond = covariance(-OWN_SIGNAL_BINS, FARTHEST * n)
    own_places = np.linspace(-OWN_SIGNAL_BINS, OWN_SIGNAL_BINS, 5)
    region_places = np.linspace(*limits, NEAR_OFFSETS.size)
    far_places = np.linspace(-OWN_SIGNAL_BINS, FARTHEST * n, 4 * NEAR_OFFSETS.size)
    choices = []
    for share, noise in EXPECTED:
        echoes = region + bool(share) * own + share * beyond
        noises = np.where(patterns, noise, UNKNOWN)[:, :, None] * np.eye(NEAR_OFFSETS.size)
        weights = np.linalg.solve(echoes + noises, echoes[:, NEAR_CARRIERS, None])[..., 0].conj() * patterns
        added = float(counts @ np.square(np.abs(weights)).sum(axis=1) / n)
        if added <= MOST_NOISE:
            missed, missed_own, missed_beyond = (
                float(_missed(weights, counts, places, n).max())
                for places in (region_places, own_places, far_places)
            )
            rank = max(missed_beyond, OWN_SIGNAL * missed_own) * (1 + added) ** 2
            choices.append((rank, missed, missed_beyond, weights))
    enough = max(MISSED, ABOUT * min(missed for _, missed, *_ in choices))
    _, missed, missed_beyond, weights = min(
        (choice for choice in choices if choice[1] <= enough), key=itemgetter(0)
    )
    return NullCarriers(used, null, weights[pattern.ravel()], missed, missed_beyond)


def _missed(weights: Complex, counts: NDArray[Any], places: Floats, n: int) -> Floats:
    """Bounds (k,) of what weights (p, offsets), of counts (p,) of null carriers, leave of echoes."""
    echoes = np.exp(-2j * np.pi / n * np.multiply.outer(NEAR_OFFSETS, places))
    return counts @ np.abs(1 - weights @ echoes) / n


def used_band(used: Mask) -> slice:
    """Band from the first subcarrier that is used to the last.

    Parameters
    ----------
    used : ndarray of bool, shape (n_subcarriers,)
        One True at least.
    """
    first, last = np.flatnonzero(used)[[0, -1]].tolist()
    return slice(first, last + 1)
