"""The kernels that an echo consists of: exponentials in range, Doppler and direction."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from isacbench.checked_arrays import Complex, Floats, checked_array

PERIOD = 2.0
"""Distance of two u, or two w, that look alike."""

SERIES_BELOW = 1e-3
"""Distance in bins below which slopes come from the series at the peak: their quotients lose digits there."""


def dirichlet(bins: ArrayLike, places: ArrayLike, n: int, every: int = 1, first: int = 0) -> Complex:
    """Response of the bins of a unitary inverse DFT (range) to unit exponentials at fractional bins.

    Behind a forward DFT (Doppler) the response is the complex conjugate.

    Parameters
    ----------
    bins : array_like, shape (b,)
        Bins at which the transform is read.
    places : array_like, shape (k,)
        Fractional bins of the exponentials.
    n : int
        Transform length.
    every, first : int
        Of the n samples only `first`, `first` + `every` and so on are not 0; `every` divides n.

    Returns
    -------
    ndarray of complex128, shape (b, k)
        n^(-1/2) Σ_i exp(j2π i (bin - place) / n), times `every`: the peak is as high whatever is left out.
    """
    distance = checked_array("bins", bins)[:, None] - checked_array("places", places)[None, :]
    # Whole turns of the kernel are taken out first: sines of small angles keep their digits.
    length = n // every
    turned = distance - length * np.rint(distance / length)
    ratio = np.sinc(turned) / np.sinc(turned / length)
    kernel: Complex = np.sqrt(n) * ratio * np.exp(1j * np.pi * (length - 1) / length * turned)
    if first:
        kernel *= np.exp(2j * np.pi * first / n * distance)
    return kernel


def dirichlet_slopes(distance: ArrayLike, n: int, order: int = 2) -> tuple[Floats, ...]:
    """Dirichlet kernel sin(πx) / (n sin(πx/n)) at x bins, and its first two derivatives per bin (order 2).

    At x = 0 they are 1, 0 and -π²(1 - n⁻²)/3: the kernel is referred to the middle of its aperture.
    """
    distance = np.asarray(distance, dtype=np.float64)
    turns = np.rint(distance / n)
    x = distance - n * turns
    half_turns = turns * (n - 1) / 2
    sign = np.where(half_turns == np.rint(half_turns), 1.0, -1.0)
    # Second and fourth derivative at the peak.
    at_peak = -(np.pi**2) * (1 - n**-2) / 3
    fourth = np.pi**4 * (1 - n**-2) * (3 - 7 * n**-2) / 15
    close = np.abs(x) < SERIES_BELOW
    x_far = np.where(close, 0.5, x)
    (sine, cosine), (sine_of_n, cosine_of_n) = sine_cosine(np.pi * x_far / n), sine_cosine(np.pi * x_far)
    value = sine_of_n / (n * sine)
    square = x * x
    kernel = sign * np.where(close, 1 + square * (at_peak / 2 + fourth / 24 * square), value)
    if not order:
        return (kernel,)
    slope = np.pi / n * (cosine_of_n - cosine * value) / sine
    # (n sin(πx/n) D)'' = -π² n sin(πx/n) D, solved for D''.
    curvature = -(np.pi**2) * (1 - n**-2) * value - 2 * np.pi / n * cosine / sine * slope
    return (
        kernel,
        sign * np.where(close, x * (at_peak + fourth / 6 * square), slope),
        sign * np.where(close, at_peak + fourth / 2 * square, curvature),
    )


def sine_cosine(angle: Floats) -> tuple[Floats, Floats]:
    """Sines and cosines of angles, from one tangent: numpy takes a tenth of the time for it."""
    half = np.tan(angle / 2)
    square = half * half
    return 2 * half / (1 + square), (1 - square) / (1 + square)


def within_period(cosine: Floats, middle: float = 0.0) -> Floats:
    """Cosines of the same plane waves that are nearest to a middle, by default those from -1 to 1.

    Returns
    -------
    ndarray of float64, same shape
        Those at most 1 from the middle stay as they are.
    """
    return cosine - PERIOD * np.rint((cosine - middle) / PERIOD)


def steering(n_elements: int, cosine: ArrayLike) -> Complex:
    """Response exp(-jπ p u) of a line of elements p = 0, 1, ..., which ascend towards -u.

    Parameters
    ----------
    cosine : array_like, shape (...)
        Direction cosines along the line, times the spacing over half a wavelength.

    Returns
    -------
    ndarray of complex128, shape (..., n_elements)

    Examples
    --------
    >>> steering(3, [1.0]).real.round(12).tolist()
    [[1.0, -1.0, 1.0]]
    """
    cosine = checked_array("cosine", cosine)
    # Powers of one exponential: exponentials of all elements cost ten times as much.
    turn = np.exp(-1j * np.pi * cosine)
    return np.vander(turn.ravel(), n_elements, increasing=True).reshape(*cosine.shape, n_elements)
