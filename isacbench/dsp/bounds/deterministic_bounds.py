"""Deterministic Cramér-Rao bound: each scatterer has an unknown complex amplitude, the same in all trials."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from isacbench.checked_arrays import Floats, checked_array
from isacbench.choices import Sensing
from isacbench.dsp.bounds.echo_slopes import N_PARAMETERS, EchoSlopes, echo_slopes
from isacbench.dsp.bounds.fisher_inverse import Bound, JointBound, KnownPart, inverse_where_known
from isacbench.errors import require
from isacbench.model.numerology import System

N_NUISANCE = 2
"""Unknowns of a scatterer besides its parameters: real and imaginary part of its amplitude."""


def single_bound(
    system: System, array_shape: tuple[int, int], snr: ArrayLike, sensing: Sensing = "all"
) -> Bound:
    """Bound of one scatterer alone, in closed form, for any place of the scatterer.

    The bound is the inverse of 2 SNR times the covariance of the phase slopes
    of the four parameters over all sensed elements. On the full grid it is
    diagonal: a tone of n samples has the standard deviation
    sqrt(3 / (2π² snr_post (1 - 1/n²))) in bins of its DFT, after the gain of
    all elements (Rife and Boorstyn, IEEE Trans. Inf. Theory 20, 1974). The comb
    of the PRS couples range and velocity slightly.

    Parameters
    ----------
    array_shape : (int, int)
        Virtual elements (P, Q), at least 2 each.
    snr : array_like, shape (...)
        |G|²/σ² per resource element and virtual element.
    sensing : {"all", "prs"}
        Resource elements that are used.

    Returns
    -------
    Bound
        Of the shape of `snr`.

    Raises
    ------
    InputError
        If the elements that are used do not determine all four parameters, or
        a ratio is not positive.

    Examples
    --------
    >>> from isacbench.model.numerology import System
    >>> bound = single_bound(System(), (16, 16), snr=1e-6)
    >>> round(float(bound.range_m), 4), round(float(bound.u), 4)
    (0.011, 0.0045)
    """
    snr = _positive(snr, "snr")
    slopes = echo_slopes(system, array_shape, sensing)
    # The centroid is the origin of the slopes, so that second moments are covariances.
    second_moments = slopes.moments()[1:, 1:]
    unit_covariance = np.outer(slopes.units, slopes.units) * np.linalg.inv(2 * second_moments)
    return Bound(unit_covariance / snr[..., None, None])


def joint_bound(
    system: System,
    array_shape: tuple[int, int],
    range_m: ArrayLike,
    velocity_mps: ArrayLike,
    u: ArrayLike,
    w: ArrayLike,
    amplitude: ArrayLike,
    noise_power: float,
    sensing: Sensing = "all",
) -> JointBound:
    """Bound of several scatterers whose parameters and complex amplitudes are all unknown.

    The Fisher matrix has six real unknowns a scatterer; the bound is the block
    of the parameters in its inverse. The cost is that of the eigenvalues of a (6K, 6K) matrix and
    of products (K, n) x (n, K) with n each axis's length.

    Parameters
    ----------
    array_shape : (int, int)
        Virtual elements (P, Q), at least 2 each.
    range_m, velocity_mps, u, w : array_like, shape (K,)
    amplitude : array_like of complex, shape (K,)
        G of each echo, its carrier phase included. Relative phases matter: scatterers
        closer than a Rayleigh cell are hardest to tell apart where their echoes
        are in phase at the middle of the aperture.
    noise_power : float
        σ² per resource element and virtual element.
    sensing : {"all", "prs"}
        Resource elements that are used.

    Returns
    -------
    JointBound
        Scatterers in one place, or so close that double precision cannot tell
        their Fisher matrix from a singular one, have infinite variances; the
        others' bounds are unaffected.

    Raises
    ------
    InputError
        If the elements that are used do not determine all four parameters of
        a scatterer alone, an amplitude is 0, or numbers are not finite or not as many.

    References
    ----------
    Stoica and Nehorai, "MUSIC, maximum likelihood, and Cramér-Rao bound", IEEE
    Trans. Acoust., Speech, Signal Process. 37 (1989).

    Examples
    --------
    Two equal scatterers half a range bin apart: range is 9 times harder to
    know than for either alone.

    >>> from isacbench.model.numerology import System
    >>> system, one = System(), np.ones(2)
    >>> apart = np.array([0.0, system.range_bin_m / 2])
    >>> in_phase = np.exp(1j * np.pi * np.array([0.0, 0.5]))
    >>> joint = joint_bound(system, (16, 16), 80 + apart, 0 * one, 0 * one, 0 * one, in_phase, 1.0)
    >>> single = single_bound(system, (16, 16), 1.0)
    >>> (joint.range_m / single.range_m).round(1)
    array([9.4, 9.4])
    """
    gain = checked_array("amplitude", amplitude, np.complex128)
    slopes = echo_slopes(system, array_shape, sensing)
    places = slopes.in_units(gain.shape, range_m, velocity_mps, u, w)
    require(bool(np.all(np.isfinite(gain) & (gain != 0))), "amplitude", gain, "a number other than 0")
    require(0 < noise_power < np.inf, "noise_power", noise_power, "a positive power")
    fisher, scale = _unit_fisher(slopes, places, np.angle(gain))
    covariance = inverse_where_known(KnownPart.of(fisher), N_NUISANCE)
    # From unit columns back to parameters in their units, of echoes of this strength in this noise.
    per_column = slopes.units[:, None] * np.sqrt(noise_power / 2) / np.abs(gain) / scale[1:, None]
    return JointBound.of_columns(covariance, per_column)


def _positive(ratio: ArrayLike, name: str) -> Floats:
    """Signal-to-noise ratios as an array, checked."""
    checked = checked_array(name, ratio)
    require(bool(np.all((checked > 0) & (checked < np.inf))), name, ratio, "a positive ratio |G|²/σ²")
    return checked


def _unit_fisher(slopes: EchoSlopes, places: Floats, phase: Floats) -> tuple[Floats, Floats]:
    """Fisher matrix of echoes as columns of unit norm, and the norms (5,) of the columns.

    Returns (6, K, 6, K): real and imaginary part of the amplitude, then the four parameters.
    """
    gram = slopes.gram(places)
    norm = np.sqrt(np.diagonal(gram[:, :, 0, 0]).real)
    # Slopes of an echo are j x times the echo, of a change of its amplitude 1 and j times the echo.
    echo = np.exp(1j * (phase + slopes.reference @ places))
    column = np.array([0, *range(N_PARAMETERS + 1)])
    factor = np.array([1, *[1j] * (N_PARAMETERS + 1)])[:, None] * echo
    fisher = np.empty((column.size, echo.size, column.size, echo.size))
    for i, j in np.ndindex(column.size, column.size):
        product = np.outer(factor[i].conj(), factor[j]) * gram[column[i], column[j]]
        fisher[i, :, j, :] = product.real / (norm[column[i]] * norm[column[j]])
    return fisher, norm
