"""Gray-mapped QAM: bits to symbols, symbols to bits, and how often that goes wrong in white noise."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from scipy.special import ndtr

from isacbench.choices import Modulation
from isacbench.errors import InputError, unknown_name

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

BITS: dict[Modulation, int] = {"qpsk": 2, "16qam": 4, "64qam": 6, "256qam": 8}


def bits_per_symbol(modulation: Modulation) -> int:
    """Bits of a symbol.

    Raises
    ------
    InputError
        If there is no such modulation.
    """
    if modulation not in BITS:
        raise unknown_name("modulation", modulation, get_args(Modulation))
    return BITS[modulation]


def constellation(modulation: Modulation) -> NDArray[np.complex128]:
    """Symbols of unit mean power, by the number that their bits spell, first bit highest.

    Parameters
    ----------
    modulation : {"qpsk", "16qam", "64qam", "256qam"}

    Returns
    -------
    ndarray of complex128, shape (2 ** bits_per_symbol,)

    Raises
    ------
    InputError
        If there is no such modulation.

    References
    ----------
    3GPP TS 38.211, 5.1.3 to 5.1.6.

    Examples
    --------
    >>> (constellation("qpsk") * np.sqrt(2)).round(12).tolist()
    [(1+1j), (1-1j), (-1+1j), (-1-1j)]
    """
    return _constellation(bits_per_symbol(modulation))


def modulate_bits(bits: ArrayLike, modulation: Modulation) -> NDArray[np.complex128]:
    """Map bits to symbols.

    Parameters
    ----------
    bits : array_like of 0 and 1, shape (n * bits_per_symbol,)
    modulation : {"qpsk", "16qam", "64qam", "256qam"}

    Returns
    -------
    ndarray of complex128, shape (n,)

    Raises
    ------
    InputError
        If there is no such modulation, or the bits fill no whole number of
        symbols, or are none.

    Examples
    --------
    >>> (modulate_bits([1, 1, 1, 1], "16qam") * np.sqrt(10)).round(12).tolist()
    [(-3-3j)]
    """
    n_bits = bits_per_symbol(modulation)
    values = np.asarray(bits)
    if values.ndim != 1 or values.size % n_bits:
        raise InputError(f"bits of shape {values.shape}: allowed is one axis of a multiple of {n_bits}")
    if values.dtype.kind not in "biu" or (values.size and (values.min() < 0 or values.max() > 1)):
        raise InputError(f"bits of dtype {values.dtype}: allowed are the whole numbers 0 and 1")
    words = values.astype(np.uint8, copy=False).reshape(-1, n_bits)
    # Eight bits at most: numbers of words fit into a byte.
    index = np.zeros(len(words), dtype=np.uint8)
    for bit in words.T:
        index += index
        index += bit
    return _constellation(n_bits)[index]


def decide_bits(symbols: ArrayLike, modulation: Modulation) -> NDArray[np.uint8]:
    """Bits of the nearest symbols of the constellation.

    Parameters
    ----------
    symbols : array_like of complex, any shape
        Not NaN; infinite parts are nearest to the outermost levels.
    modulation : {"qpsk", "16qam", "64qam", "256qam"}

    Returns
    -------
    ndarray of uint8, shape (symbols.size * bits_per_symbol,)
        Zeros and ones, symbol by symbol.

    Raises
    ------
    InputError
        If there is no such modulation, or a symbol is NaN: it has no nearest.

    Examples
    --------
    >>> decide_bits(modulate_bits([0, 1, 1, 0], "16qam") + 0.1, "16qam").tolist()
    [0, 1, 1, 0]
    """
    n_bits = bits_per_symbol(modulation)
    received = np.asarray(symbols, dtype=np.complex128).ravel()
    if np.isnan(received).any():
        raise InputError(f"symbols hold {int(np.isnan(received).sum())} NaN: allowed are numbers")
    words = np.zeros(received.size, dtype=np.uint8)
    for amplitude, share in zip((received.real, received.imag), _axis_words(n_bits), strict=True):
        # Levels are 2 units apart, the lowest at 1 - L.
        highest = len(share) - 1
        level = np.rint(amplitude * (0.5 / _unit(n_bits)) + highest / 2)
        words += share[np.clip(level, 0, highest, out=level).astype(np.uint8)]
    return np.unpackbits(words[:, None], axis=1)[:, -n_bits:].ravel()


def awgn_ber(modulation: Modulation, snr_db: ArrayLike) -> NDArray[np.float64]:
    """Bit error rate of nearest-symbol decisions in white Gaussian noise, exactly.

    Real and imaginary part decide half of the bits each. Of each bit, of every
    level sent, the probabilities of all levels decided for that differ in the
    bit are summed.

    Parameters
    ----------
    modulation : {"qpsk", "16qam", "64qam", "256qam"}
    snr_db : array_like, any shape
        Mean symbol power over noise power, E_s/N_0.

    Returns
    -------
    ndarray of float64, same shape

    Raises
    ------
    InputError
        If there is no such modulation.

    References
    ----------
    Cho and Yoon, "On the general BER expression of one- and two-dimensional
    amplitude modulations", IEEE Trans. Commun. 50 (2002), has the same sums.

    Examples
    --------
    >>> round(float(awgn_ber("qpsk", 9.59)), 6)
    0.001279
    """
    n_bits = bits_per_symbol(modulation)
    labels = _axis_labels(n_bits // 2).astype(np.int64)
    n_levels = len(labels)
    # Standard deviation along one axis, in units of half the distance of levels.
    with np.errstate(over="ignore"):
        sigma = 10 ** (-np.asarray(snr_db, dtype=np.float64) / 20) / np.sqrt(2) / _unit(n_bits)
    levels = 2.0 * np.arange(n_levels) + 1 - n_levels
    n_wrong = (labels[:, None, :] != labels[None, :, :]).sum(axis=2)
    rate = np.zeros(sigma.shape)
    with np.errstate(divide="ignore"):
        for sent in range(n_levels):
            for decided in range(n_levels):
                if n_wrong[sent, decided]:
                    rate += n_wrong[sent, decided] * _share(levels[sent], levels[decided], n_levels, sigma)
    total: NDArray[np.float64] = rate / (n_levels * n_bits // 2)
    return total


def _share(sent: float, decided: float, n_levels: int, sigma: NDArray[np.float64]) -> NDArray[np.float64]:
    """Probability that noise moves one level into the cell of another; tails keep their digits."""
    distance = abs(decided - sent)
    near = ndtr(-(distance - 1) / sigma)
    is_outermost = abs(decided) == n_levels - 1
    share: NDArray[np.float64] = near if is_outermost else near - ndtr(-(distance + 1) / sigma)
    return share


def _unit(n_bits: int) -> float:
    """Half the distance of neighbouring levels in a constellation of unit mean power."""
    return float(np.sqrt(3 / 2 / (2**n_bits - 1)))


@lru_cache
def _axis_labels(n_bits: int) -> NDArray[np.uint8]:
    """Bits (2 ** n_bits, n_bits) of the levels along one axis, the lowest level first."""
    words = np.arange(2**n_bits)
    bits = (words[:, None] >> np.arange(n_bits)[::-1]) & 1
    labels = bits[np.argsort(_axis_levels(bits))].astype(np.uint8)
    labels.setflags(write=False)
    return labels


@lru_cache
def _axis_words(n_bits: int) -> NDArray[np.uint8]:
    """What the levels (2, n_levels) of both axes add to the number that the bits of a symbol spell."""
    labels = _axis_labels(n_bits // 2)
    real = (labels * 2 ** np.arange(n_bits - 1, 0, -2, dtype=np.uint8)).sum(axis=1, dtype=np.uint8)
    words = np.stack([real, real >> 1])
    words.setflags(write=False)
    return words


def _axis_levels(bits: NDArray[Any]) -> NDArray[np.int64]:
    """Levels (n,), odd numbers, of bits (n, k): each further bit says on which side of the middle one is."""
    signs = 1 - 2 * bits.astype(np.int64)
    level = np.ones(len(bits), dtype=np.int64)
    for order, column in enumerate(signs.T[:0:-1]):
        level = 2 ** (order + 1) - column * level
    return signs[:, 0] * level


@lru_cache
def _constellation(n_bits: int) -> NDArray[np.complex128]:
    words = np.arange(2**n_bits)
    bits = (words[:, None] >> np.arange(n_bits)[::-1]) & 1
    points = np.empty(len(words), dtype=np.complex128)
    points.real, points.imag = (_unit(n_bits) * _axis_levels(bits[:, axis::2]) for axis in (0, 1))
    points.setflags(write=False)
    return points
