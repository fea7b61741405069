"""Gray-mapped QAM: bits to symbols, symbols to bits, and bit error rates in white noise."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from isacbench.checked_arrays import Complex, Floats, Integers, checked_array, unmasked_array
from isacbench.choices import Modulation
from isacbench.errors import InputError, require_known

BITS: dict[Modulation, int] = {"qpsk": 2, "16qam": 4, "64qam": 6, "256qam": 8}


def bits_per_symbol(modulation: Modulation) -> int:
    """Count the bits of a symbol; an `InputError` where there is no such modulation."""
    require_known("modulation", modulation, BITS)
    return BITS[modulation]


@lru_cache
def constellation(modulation: Modulation) -> Complex:
    """List the symbols of unit mean power, by the number that their bits spell, first bit highest.

    Returns
    -------
    ndarray of complex128, shape (2 ** bits_per_symbol,)
        Read-only.

    References
    ----------
    3GPP TS 38.211, 5.1.3 to 5.1.6.

    Examples
    --------
    >>> (constellation("qpsk") * np.sqrt(2)).round(12).tolist()
    [(1+1j), (1-1j), (-1+1j), (-1-1j)]
    """
    n_bits = bits_per_symbol(modulation)
    words = _words(n_bits)
    points = np.empty(len(words), dtype=np.complex128)
    points.real, points.imag = (_unit(n_bits) * _axis_levels(words[:, axis::2]) for axis in (0, 1))
    points.setflags(write=False)
    return points


def modulate_bits(bits: ArrayLike, modulation: Modulation) -> Complex:
    """Map bits to symbols.

    Parameters
    ----------
    bits : array_like of 0 and 1, shape (n * bits_per_symbol,)

    Returns
    -------
    ndarray of complex128, shape (n,)

    Raises
    ------
    InputError
        If there is no such modulation, or the bits fill no whole number of
        symbols, or are none.
    """
    n_bits = bits_per_symbol(modulation)
    values = unmasked_array("bits", bits)
    if values.ndim != 1 or values.size % n_bits:
        raise InputError(f"bits of shape {values.shape}: allowed is one axis of a multiple of {n_bits}")
    if values.dtype.kind not in "biu" or (values.size and (values.min() < 0 or values.max() > 1)):
        raise InputError(f"bits of dtype {values.dtype}: allowed are the whole numbers 0 and 1")
    place_values = 2 ** np.arange(n_bits, dtype=np.uint8)[::-1]
    words: NDArray[np.uint8] = values.astype(np.uint8, copy=False).reshape(-1, n_bits) @ place_values
    return constellation(modulation)[words]


def decide_bits(symbols: ArrayLike, modulation: Modulation) -> NDArray[np.uint8]:
    """Decide for the nearest symbols of the constellation, and give their bits.

    Parameters
    ----------
    symbols : array_like of complex, any shape
        Not NaN; infinite parts are nearest to the outermost levels.

    Returns
    -------
    ndarray of uint8, shape (symbols.size * bits_per_symbol,)
        Zeros and ones, symbol by symbol.

    Raises
    ------
    InputError
        If there is no such modulation, or a symbol is NaN: it has no nearest.
    """
    n_bits = bits_per_symbol(modulation)
    received = checked_array("symbols", symbols, np.complex128).ravel()
    if np.isnan(received).any():
        raise InputError(f"symbols hold {int(np.isnan(received).sum())} NaN: allowed are numbers")
    labels = _axis_labels(n_bits // 2)
    highest = len(labels) - 1
    bits = np.empty((received.size, n_bits), dtype=np.uint8)
    for axis, amplitude in enumerate((received.real, received.imag)):
        # Levels are 2 units apart, the lowest at 1 - L.
        level = np.rint(amplitude * (0.5 / _unit(n_bits)) + highest / 2)
        bits[:, axis::2] = np.take(labels, np.clip(level, 0, highest).astype(np.uint8), axis=0)
    return bits.ravel()


def awgn_ber(modulation: Modulation, snr_db: ArrayLike) -> Floats:
    """Compute the exact bit error rate of nearest-symbol decisions in white Gaussian noise.

    Real and imaginary part decide half of the bits each. Of each bit, of every
    level sent, the probabilities of all levels decided for that differ in the
    bit are summed.

    Parameters
    ----------
    snr_db : array_like, any shape
        Mean symbol power over noise power, E_s/N_0.

    Returns
    -------
    ndarray of float64, same shape

    References
    ----------
    Cho and Yoon, "On the general BER expression of one- and two-dimensional
    amplitude modulations", IEEE Trans. Commun. 50 (2002), has the same sums.
    """
    n_bits = bits_per_symbol(modulation)
    labels = _axis_labels(n_bits // 2)
    n_levels = len(labels)
    n_wrong = (labels[:, None, :] != labels).sum(axis=2)
    levels = 2.0 * np.arange(n_levels) + 1 - n_levels
    distance = np.abs(levels[:, None] - levels)
    is_outermost = np.abs(levels) == n_levels - 1
    with np.errstate(over="ignore", divide="ignore"):
        # Standard deviation along one axis, in units of half the distance of levels.
        sigma = 10 ** (-checked_array("snr_db", snr_db) / 20) / np.sqrt(2) / _unit(n_bits)
        sigma = sigma[..., None, None]
        # Probability of each decided level, as a difference of tails, which keep their digits.
        share = ndtr((1 - distance) / sigma) - np.where(is_outermost, 0, ndtr(-(1 + distance) / sigma))
    return (n_wrong * share).sum(axis=(-2, -1)) / (n_levels * n_bits // 2)


def _unit(n_bits: int) -> float:
    """Half the distance of neighbouring levels in a constellation of unit mean power."""
    return float(np.sqrt(3 / 2 / (2**n_bits - 1)))


def _words(n_bits: int) -> NDArray[np.uint8]:
    """Bits (2 ** n_bits, n_bits) of all words, in the order of the numbers that they spell."""
    return np.unpackbits(np.arange(2**n_bits, dtype=np.uint8)[:, None], axis=1)[:, -n_bits:]


def _axis_labels(n_bits: int) -> NDArray[np.uint8]:
    """Bits (2 ** n_bits, n_bits) of the levels along one axis, the lowest level first."""
    words = _words(n_bits)
    return words[np.argsort(_axis_levels(words))]


def _axis_levels(bits: NDArray[np.uint8]) -> Integers:
    """Levels (n,), odd numbers, of bits (n, k): each further bit says on which side of the middle one is."""
    signs = 1 - 2 * bits.astype(np.int64)
    level = np.ones(len(bits), dtype=np.int64)
    for order, column in enumerate(signs.T[:0:-1]):
        level = 2 ** (order + 1) - column * level
    return signs[:, 0] * level
