"""Cramér-Rao bounds: of unknown amplitudes, of random ones, and of positions in space."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from isacbench.checked_arrays import Complex, Floats, Mask, checked_array
from isacbench.choices import Sensing
from isacbench.dsp.bounds.fisher_matrices import (
    N_PARAMETERS,
    Bound,
    EchoSlopes,
    JointBound,
    KnownPart,
    echo_slopes,
    inverse_where_known,
)
from isacbench.errors import require
from isacbench.model.frame import Frame
from isacbench.model.numerology import System

N_NUISANCE = 2
"""Unknowns of a scatterer besides its parameters: real and imaginary part of its amplitude."""

ROUNDING = 1e-9
"""Share by which a covariance may miss being Hermitian and positive semidefinite."""


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


def stochastic_bound(
    system: System,
    array_shape: tuple[int, int],
    range_m: ArrayLike,
    velocity_mps: ArrayLike,
    u: ArrayLike,
    w: ArrayLike,
    covariance: ArrayLike,
    noise_power: float,
    n_frames: int = 1,
    sensing: Sensing = "all",
) -> JointBound:
    """Bound of scatterers whose amplitudes are random from frame to frame and whose places are not.

    Amplitudes are zero-mean circular complex Gaussian, independent from frame to frame. Their
    covariance, the noise power and all places are unknown.

    Parameters
    ----------
    array_shape : (int, int)
        Virtual elements (P, Q), at least 2 each.
    range_m, velocity_mps, u, w : array_like, shape (K,)
    covariance : array_like of complex, shape (K, K), or of float, shape (K,)
        E[G Gᴴ] of the amplitudes G of `joint_bound`, Hermitian and positive semidefinite; or
        their powers E|G|², where they are uncorrelated.
    noise_power : float
        σ² per resource element and virtual element.
    n_frames : int
        Frames that are observed.
    sensing : {"all", "prs"}
        Resource elements that are used.

    Returns
    -------
    JointBound
        Scatterers that double precision cannot tell apart have infinite variances, as in `joint_bound`.

    Raises
    ------
    InputError
        If the elements that are used do not determine all four parameters of a scatterer alone, the
        matrix is no covariance or has a power of 0, or numbers are not finite or not as many.

    References
    ----------
    Stoica and Nehorai, "Performance study of conditional and unconditional direction-of-arrival
    estimation", IEEE Trans. Acoust., Speech, Signal Process. 38 (1990). Stoica, Larsson and Gershman,
    "The stochastic CRB for array processing: a textbook derivation", IEEE Signal Process. Lett. 8 (2001).

    Examples
    --------
    One scatterer: variances are those of `single_bound`, times 1 + 1/SNR_post.

    >>> from isacbench.dsp.bounds import single_bound
    >>> from isacbench.model.numerology import System
    >>> system = System()
    >>> snr = 2 / (system.processing_gain * 16 * 16)
    >>> bound = stochastic_bound(system, (16, 16), [80.0], [3.0], [0.1], [0.2], [snr], 1.0)
    >>> round(float(bound.range_m[0] / single_bound(system, (16, 16), snr).range_m) ** 2, 6)
    1.5
    """
    power, root = _checked_root(covariance)
    require(0 < noise_power < np.inf, "noise_power", noise_power, "a positive power")
    require(n_frames >= 1 and n_frames % 1 == 0, "n_frames", n_frames, "a whole number from 1 up")
    slopes = echo_slopes(system, array_shape, sensing)
    places = slopes.in_units(power.shape, range_m, velocity_mps, u, w)
    gram = slopes.gram(places).transpose(0, 2, 1, 3)
    norm = np.sqrt(np.diagonal(gram[:, 0, :, 0]).real)
    gram = gram / norm[:, None, None, None] / norm[:, None]
    # Slopes are those from the middle of the aperture, and so must be the amplitudes.
    to_middle = np.exp(1j * (slopes.reference @ places))
    root = (np.sqrt(power) * to_middle)[:, None] * root
    effective, strength = _effective_covariance(root, norm[0] ** 2 * gram[0, :, 0], noise_power)
    left, length, merged = _unexplained(gram)
    # Divided by the lengths, entries have the rounding errors of 1, as `KnownPart` wants it.
    fisher = (left * effective.T[:, None, :]).real / (length[:, :, None, None] * length)
    known = KnownPart.of(fisher)
    inverse = inverse_where_known(replace(known, merged=known.merged | merged))
    per_column = (slopes.units / norm[1:])[:, None] / (np.sqrt(2 * n_frames) * strength * length)
    return JointBound.of_columns(inverse, per_column)


def _checked_root(covariance: ArrayLike) -> tuple[Floats, Complex]:
    """Powers (K,), and a factor L (K, K) of the amplitudes' correlations L Lᴴ."""
    given = checked_array("covariance", covariance, np.complex128)
    matrix = np.diag(given) if given.ndim == 1 else given
    square = matrix.ndim == 2 and matrix.shape[0] == matrix.shape[1] and matrix.size > 0
    allowed = square and bool(np.all(np.isfinite(matrix)))
    require(allowed, "covariance", covariance, "K powers or a (K, K) matrix, finite")
    power = np.diagonal(matrix).real
    require(bool(np.all(power > 0)), "covariance", covariance, "one of positive powers")
    # Of unit powers, so that weak scatterers keep their digits beside strong ones.
    correlation = matrix / np.sqrt(power)[:, None] / np.sqrt(power)
    eigenvalue, vector = np.linalg.eigh(correlation)
    hermitian = np.allclose(correlation, correlation.conj().T, rtol=0, atol=ROUNDING)
    allowed = hermitian and bool(eigenvalue[0] >= -ROUNDING * len(power))
    require(allowed, "covariance", covariance, "Hermitian and positive semidefinite")
    return power, vector * np.sqrt(np.maximum(eigenvalue, 0))


def _effective_covariance(root: Complex, gram: Complex, noise_power: float) -> tuple[Complex, Floats]:
    """S Aᴴ R⁻¹ A S with a diagonal of 1, and square roots (K,) of its diagonal over σ².

    It is L H (H + σ²)⁻¹ Lᴴ, where S = L Lᴴ and H = Lᴴ Aᴴ A L: of each component counts SNR/(1 + SNR).
    """
    snr, vector = np.linalg.eigh(root.conj().T @ gram @ root / noise_power)
    snr = np.maximum(snr, 0)
    seen = root @ vector * np.sqrt(snr / (1 + snr))
    strength = np.linalg.norm(seen, axis=1)
    # Echoes that cancel each other lie in one place, and have no bound.
    strength[strength == 0] = 1
    seen /= strength[:, None]
    return seen @ seen.conj().T, strength / np.sqrt(noise_power)


def _unexplained(gram: Complex) -> tuple[Complex, Floats, Mask]:
    """Inner products (4, K, 4, K) of slopes without what changes of the amplitudes explain.

    Also the length (4, K) of each slope with these changes, and which echoes (K,) are one and the same.
    """
    echoes = KnownPart.of(gram[:1, :, :1])
    spread = np.sqrt(echoes.eigenvalue)[:, None, None]
    explained = np.tensordot(echoes.vector[0].conj(), gram[0, :, 1:], (0, 0)) / spread
    length = np.sqrt(1 + np.sum(np.abs(explained / spread) ** 2, axis=0))
    return gram[1:, :, 1:] - np.tensordot(explained.conj(), explained, (0, 0)), length, echoes.merged


def position_covariance(
    frame: Frame, range_m: ArrayLike, u: ArrayLike, w: ArrayLike, covariance: ArrayLike
) -> Floats:
    """Propagate covariances to positions in space, to first order.

    Parameters
    ----------
    range_m, u, w : array_like, shape (K,)
        Places of the scatterers.
    covariance : array_like, shape (K, 4, 4) or (4, 4)
        Of (R, v, u, w), as in `Bound`.

    Returns
    -------
    ndarray of float64, shape (K, 4, 4)
        Of (x, y, z, v), in m and m/s. As in `Bound`, a scatterer without a bound has
        infinite variances and NaN elsewhere. Of x, y and z all is NaN where the
        frame is singular or blind.

    Examples
    --------
    A street's scatterer, seen by a panel: x is uncertain by R times u.

    >>> from isacbench.dsp.bounds import single_bound
    >>> from isacbench.model.frame import PanelFrame
    >>> from isacbench.model.numerology import System
    >>> bound = single_bound(System(), (16, 16), snr=1e-3)
    >>> xyzv = position_covariance(PanelFrame(), [90.0], [0.01], [0.2], bound.covariance)
    >>> round(float(np.sqrt(xyzv[0, 0, 0]) / (90 * bound.u)), 3)
    1.0
    """
    jacobian = frame.offset_jacobian(range_m, u, w)
    into_space = np.zeros((len(jacobian), N_PARAMETERS, N_PARAMETERS))
    into_space[:, :3, [0, 2, 3]] = jacobian
    into_space[:, 3, 1] = 1
    covariance = np.broadcast_to(np.asarray(covariance, dtype=np.float64), into_space.shape)
    known = np.all(np.isfinite(covariance), axis=(1, 2))
    transported = np.full(into_space.shape, np.nan)
    transported[:, np.arange(N_PARAMETERS), np.arange(N_PARAMETERS)] = np.inf
    into_space = into_space[known]
    transported[known] = into_space @ covariance[known] @ into_space.transpose(0, 2, 1)
    return transported
