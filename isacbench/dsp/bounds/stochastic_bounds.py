"""Stochastic Cramér-Rao bound: amplitudes are random, Gaussian, and independent from frame to frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from isacbench.checked_arrays import Complex, Floats, Mask, checked_array
from isacbench.choices import Sensing
from isacbench.dsp.bounds.echo_slopes import echo_slopes
from isacbench.dsp.bounds.fisher_inverse import JointBound, KnownPart, inverse_where_known
from isacbench.errors import require
from isacbench.model.numerology import System

ROUNDING = 1e-9
"""Share by which a covariance may miss being Hermitian and positive semidefinite."""


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
        covariance is none or has a power of 0, or numbers are not finite or not as many.

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
