"""Number of sources in a covariance: four tests of its eigenvalues.

A smoothed covariance is made of overlapping pieces of one snapshot. Its noise
eigenvalues scatter far more than those of as many independent snapshots, so
that textbook thresholds see sources in noise; each test here states the number
of snapshots that it counts as independent.

References
----------
Wax and Kailath, "Detection of signals by information theoretic criteria",
IEEE Trans. ASSP 33 (1985).
Marchenko and Pastur, "Distribution of eigenvalues for some sets of random
matrices", Math. USSR Sbornik 1 (1967).
Bryc, Dembo and Jiang, "Spectral measure of large random Hankel, Markov and
Toeplitz matrices", Ann. Probab. 34 (2006), on eigenvalues without an edge.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from isacbench.checked_arrays import Floats, Integers
from isacbench.dsp.angles.line_subspaces import Eigenpairs
from isacbench.dsp.cfar.factors import ca_factor
from isacbench.dsp.cfar.training_cells import window_axes, windows_of
from isacbench.errors import require

ModelOrder = Literal["noise", "eigenvalue_cfar", "mdl", "aic"]


SMALLEST_EIGENVALUE = 1e-12
"""Relative to the largest: below, eigenvalues of a singular covariance are rounding."""

NOISE_WEIGHT_STEPS = 100
"""Steps of an alternating maximisation that gains a factor of ten in accuracy every few steps."""


def noise_edge(n_subarray: int, n_snapshots: int) -> float:
    """Largest eigenvalue of a noise covariance of unit power, for many sensors and independent snapshots.

    Upper edge (1 + sqrt(n_subarray / n_snapshots))² of the Marchenko-Pastur law. Overlapping subarrays do not
    count.
    """
    return float((1 + np.sqrt(n_subarray / n_snapshots)) ** 2)


def smoothed_noise_edge(shape: tuple[int, int], subarray: tuple[int, int], pfa: float) -> float:
    """Eigenvalue that the noise of one smoothed snapshot, of unit power, exceeds with probability pfa.

    A smoothed snapshot has few looks at many directions, and its largest
    noise eigenvalue belongs to the noise most similar to one source. A piece
    of noise of energy E raises the largest eigenvalue by at most κ E, κ the
    squared norm of the smoothing, and the strongest of P Q independent pieces
    exceeds E with probability P Q exp(-E). The noise of the other elements
    adds 1, and the gain of the eigenvector by leaning towards it half the
    sensors per subarray: together

        1 + sensors / (2 subarrays) + κ ln(P Q / pfa).

    Holds for subarrays of about half the array: with 8 x 8 of 16 x 16 a
    nominal 1e-2 and 1e-3 are 0.6e-2 and 0.9e-3 by Monte Carlo. With a quarter
    of the array, where the bulk of the noise is as large as its strongest
    piece, it is exceeded several times as often as asked.

    Parameters
    ----------
    shape : (int, int)
        Elements P x Q.
    subarray : (int, int)
        Elements of a subarray.
    pfa : float
        Probability, between 0 and 1.
    """
    lengths = list(zip(shape, subarray, strict=True))
    weight = np.prod([_noise_weight(n, n_subarray) for n, n_subarray in lengths])
    n_shifts = np.prod([n - n_subarray + 1 for n, n_subarray in lengths])
    leaning = np.prod(subarray) / (2 * n_shifts)
    return float(1 + leaning + weight * np.log(np.prod(shape) / pfa))


@lru_cache
def _noise_weight(n: int, n_subarray: int) -> float:
    """Largest eigenvalue that a unit-energy snapshot of n sensors can have, smoothed along one axis.

    max ‖x ∗ v‖² over unit x and v, by maximising in turn over v, over the
    outputs and over x; all are positive, so that there is one maximum.
    """
    n_shifts = n - n_subarray + 1
    weights, outputs = np.ones(n_subarray), np.ones(n_shifts)
    for _ in range(NOISE_WEIGHT_STEPS):
        snapshot = np.convolve(weights, outputs)
        subarrays = sliding_window_view(snapshot / np.linalg.norm(snapshot), n_subarray)
        weights = outputs @ subarrays
        weights /= np.linalg.norm(weights)
        outputs = subarrays @ weights
    return float(np.sum(outputs**2) / n_shifts)


def noise_order(eigenvalues: Floats, largest_noise: float | Floats) -> Integers:
    """Model order (n,), 1 to L - 1: eigenvalues (n, L), descending, that noise does not reach.

    A detected cell holds one source at least, and one dimension is left to the noise. `largest_noise` is one
    number, or one a cell, (n, 1).
    """
    return _bounded(np.sum(eigenvalues > largest_noise, axis=1), eigenvalues)


def eigenvalue_cfar_order(eigenvalues: Floats, pfa: float) -> Integers:
    """Model order by the paper's one-dimensional CA-CFAR over the sorted eigenvalues.

    As printed: eigenvalues that exceed their threshold are sources. On the 8
    eigenvalues of a subarray the window is tiny, and large neighbours mask
    each other.

    Parameters
    ----------
    eigenvalues : ndarray of float64, shape (n, L)
        Descending, L >= 3.

    Returns
    -------
    ndarray of int64, shape (n,)
        1 to L - 1.
    """
    n_sensors = eigenvalues.shape[1]
    require(n_sensors >= 3, "subarray elements", n_sensors, "3 and more, for a CFAR over eigenvalues")
    n_training = (n_sensors - 1) // 2
    power = np.maximum(eigenvalues, 0)
    threshold = np.empty(power.shape)
    for where, windows in windows_of(window_axes(power.shape, (0, n_training), (0, 0))):
        threshold[where] = ca_factor(pfa, windows.n_training) * windows.training(power).mean(axis=-1)
    return _bounded(np.sum(power > threshold, axis=1), eigenvalues)


def information_order(
    eigenvalues: Floats, n_independent: float, criterion: Literal["mdl", "aic"]
) -> Integers:
    """Model order by the description length or by Akaike's criterion.

    Of real covariances, as forward-backward averaging makes them: a complex
    snapshot counts twice, and k sources have k (2 L - k + 1) / 2 parameters.

    Parameters
    ----------
    eigenvalues : ndarray of float64, shape (n, L)
        Descending.
    n_independent : float
        Independent complex snapshots. For smoothed data this is the number of
        disjoint subarrays, elements of the array over those of a subarray;
        with overlapping ones the test finds sources in noise.
    criterion : {"mdl", "aic"}
        Minimum description length, or Akaike's information criterion, which
        charges less for a parameter.

    Returns
    -------
    ndarray of int64, shape (n,)
        1 to L - 1.
    """
    n_sensors = eigenvalues.shape[1]
    positive = np.maximum(eigenvalues, SMALLEST_EIGENVALUE * eigenvalues[:, :1])
    positive = np.maximum(positive, np.finfo(np.float64).tiny)
    order = np.arange(n_sensors)
    left = n_sensors - order
    arithmetic = np.cumsum(positive[:, ::-1], axis=1)[:, ::-1] / left
    log_geometric = np.cumsum(np.log(positive[:, ::-1]), axis=1)[:, ::-1] / left
    misfit = n_independent * left * (np.log(arithmetic) - log_geometric)
    n_parameters = order * (2 * n_sensors - order + 1) / 2
    charge = 1.0 if criterion == "aic" else np.log(max(2 * n_independent, 1.0)) / 2
    return _bounded(np.argmin(misfit + charge * n_parameters, axis=1), eigenvalues)


def source_count(
    pairs: Eigenpairs, method: ModelOrder, largest_noise: float, pfa: float, n_independent: float
) -> Integers:
    """Count (n,) the eigenvalues of smoothed covariances that belong to sources, by one of the four tests.

    `largest_noise` is for "noise", `pfa` for "eigenvalue_cfar", and `n_independent`, the number of
    independent complex snapshots, for "mdl" and "aic".
    """
    rounding = pairs.rounding[:, None]
    eigenvalues = np.maximum(pairs.values, rounding)
    if method == "noise":
        return noise_order(eigenvalues, np.maximum(largest_noise, rounding))
    if method == "eigenvalue_cfar":
        return eigenvalue_cfar_order(eigenvalues, pfa)
    return information_order(eigenvalues, n_independent, method)


def _bounded(order: Integers, eigenvalues: Floats) -> Integers:
    """Order from 1, of a cell that is known to hold something, to one less than there are eigenvalues."""
    return np.clip(order, 1, eigenvalues.shape[1] - 1)
