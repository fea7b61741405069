"""The three kernels that an echo consists of: exponentials in range, Doppler and direction."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["dirichlet", "steering"]

Complex = NDArray[np.complex128]


def dirichlet(bins: ArrayLike, places: ArrayLike, n: int) -> Complex:
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

    Returns
    -------
    ndarray of complex128, shape (b, k)
        n^(-1/2) Σ_i exp(j2π i (bin - place) / n).

    Examples
    --------
    >>> float(dirichlet([3], [3.0], 16)[0, 0].real)
    4.0
    """
    distance = np.asarray(bins, dtype=np.float64)[:, None] - np.asarray(places, dtype=np.float64)[None, :]
    # Whole turns of the kernel are taken out first: sines of small angles keep their digits.
    distance -= n * np.rint(distance / n)
    ratio = np.sinc(distance) / np.sinc(distance / n)
    kernel: Complex = np.sqrt(n) * ratio * np.exp(1j * np.pi * (n - 1) / n * distance)
    return kernel


def steering(n_elements: int, cosine: ArrayLike) -> Complex:
    """Response exp(-jπ p u) of a line of half-wavelength elements p = 0, 1, ...

    Parameters
    ----------
    n_elements : int
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
    phase = np.multiply.outer(np.asarray(cosine, dtype=np.float64), -np.pi * np.arange(n_elements))
    response: Complex = np.exp(1j * phase)
    return response
