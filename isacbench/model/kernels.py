"""The kernels that an echo consists of: exponentials in range, Doppler and direction."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from isacbench.checked_arrays import Complex, Floats, Integers, checked_array

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


def dirichlet_slopes(distance: ArrayLike, n: int) -> tuple[Floats, Floats, Floats]:
    """Dirichlet kernel sin(πx) / (n sin(πx/n)) at x bins, and its first two derivatives per bin.

    At x = 0 they are 1, 0 and -π²(1 - n⁻²)/3: the kernel is referred to the middle of its aperture.
    """
    distance = np.asarray(distance, dtype=np.float64)
    x = np.atleast_1d(distance)
    turns = np.rint(x / n)
    x = x - n * turns
    sign = _sign(turns * (n - 1))
    close = np.nonzero(np.abs(x) < SERIES_BELOW)
    angle = np.pi * x
    of_all = sign * np.sin(angle), sign * np.cos(angle)
    kernel = _kernel_and_slopes(
        of_all, (np.sin(angle / n), np.cos(angle / n)), close, x[close], sign[close], n
    )
    value, slope, curvature = (part.reshape(distance.shape) for part in kernel)
    return value, slope, curvature


def dirichlet_slopes_of_bins(bins: Floats, places: Floats, n: int) -> tuple[Floats, Floats, Floats]:
    """The same of whole bins (b,), ascending, at their distances from places (k,), each of shape (k, b).

    Their sines and cosines are those of whole bins and of fractions of a bin, by the theorem of addition. A
    fraction is half a bin at most, so that the difference of its products keeps its digits.
    """
    nearest = np.rint(places)
    fraction = places - nearest
    lowest, highest = bins[0] - nearest.max(initial=bins[0]), bins[-1] - nearest.min(initial=bins[0])
    steps = np.arange(lowest, highest + 1)
    turns = np.rint(steps / n)
    angle, sign, parity = np.pi / n * (steps - n * turns), _sign(turns), _sign(steps)
    at = (bins - nearest[:, None] - lowest).astype(np.int64)
    sine, cosine = (sign * np.sin(angle))[at], (sign * np.cos(angle))[at]
    less_sine, less_cosine = np.sin(np.pi / n * fraction)[:, None], np.cos(np.pi / n * fraction)[:, None]
    of_one = sine * less_cosine - cosine * less_sine, cosine * less_cosine + sine * less_sine
    of_all = tuple(
        parity[at] * part[:, None] for part in (-np.sin(np.pi * fraction), np.cos(np.pi * fraction))
    )
    near_bin = np.flatnonzero(np.abs(fraction) < SERIES_BELOW)
    place, bin_index = np.nonzero((steps % n == 0)[at[near_bin]])
    close = near_bin[place], bin_index
    return _kernel_and_slopes(of_all, of_one, close, -fraction[close[0]], (parity * sign)[at[close]], n)


def _sign(turns: Floats) -> Floats:
    """1 of even whole numbers, -1 of odd ones."""
    return 1 - 2 * (turns.astype(np.int64) & 1).astype(np.float64)


def _kernel_and_slopes(
    of_all: tuple[Floats, ...],
    of_one: tuple[Floats, Floats],
    close: tuple[Integers, ...],
    offset: Floats,
    sign: Floats,
    n: int,
) -> tuple[Floats, Floats, Floats]:
    """Kernel and slopes from the sine and cosine of πx and of πx/n.

    `close` are the indices at which they follow from the offset from a peak and its sign.
    """
    # Second and fourth derivative at the peak.
    at_peak = -(np.pi**2) * (1 - n**-2) / 3
    fourth = np.pi**4 * (1 - n**-2) * (3 - 7 * n**-2) / 15
    sine, cosine = of_one
    sine[close] = 1
    value = of_all[0] / (n * sine)
    slope = np.pi / n * (of_all[1] - cosine * value) / sine
    # (n sin(πx/n) D)'' = -π² n sin(πx/n) D, solved for D''.
    curvature = -(np.pi**2) * (1 - n**-2) * value - 2 * np.pi / n * (cosine / sine) * slope
    value[close] = sign * (1 + at_peak * offset**2 / 2 + fourth * offset**4 / 24)
    slope[close] = sign * (at_peak * offset + fourth * offset**3 / 6)
    curvature[close] = sign * (at_peak + fourth * offset**2 / 2)
    return value, slope, curvature


def steering(n_elements: int, cosine: ArrayLike) -> Complex:
    """Response exp(-jπ p u) of a line of half-wavelength elements p = 0, 1, ..., which ascend towards -u.

    Parameters
    ----------
    cosine : array_like, shape (...)
        Direction cosines along the line.

    Returns
    -------
    ndarray of complex128, shape (..., n_elements)

    Examples
    --------
    >>> steering(3, [1.0]).real.round(12).tolist()
    [[1.0, -1.0, 1.0]]
    """
    cosine = checked_array("cosine", cosine)
    turn = np.exp(-1j * np.pi * cosine)
    response = np.ones((n_elements, *cosine.shape), dtype=np.complex128)
    known = 1
    # Powers by doubling: exponentials cost ten times as much.
    while known < n_elements:
        following = response[known : 2 * known]
        np.multiply(response[: len(following)], turn, out=following)
        turn, known = turn * turn, 2 * known
    return np.ascontiguousarray(np.moveaxis(response, 0, -1))
