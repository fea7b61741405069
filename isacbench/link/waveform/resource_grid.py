"""Resource grid of a frame: positioning reference signal from Gold sequences, data elsewhere, bit rates."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import xlogy

from isacbench.checked_arrays import Complex, Floats, Mask, checked_array
from isacbench.choices import Modulation
from isacbench.display import short_repr
from isacbench.errors import require
from isacbench.link.waveform.qam import bits_per_symbol, modulate_bits
from isacbench.model.echo import random_stream
from isacbench.model.number_limits import require_all
from isacbench.model.numerology import SLOT_SYMBOLS, System, prs_elements

LARGEST_N_ID = 4095
"""Largest identity of a PRS sequence (3GPP TS 38.211, 7.4.1.7.2)."""

REGISTER = 31
"""Bits in the register of either m-sequence."""

SKIPPED = 1600
"""Bits N_C that both m-sequences drop at their start."""

FIRST_TAPS = (3,)
SECOND_TAPS = (1, 2, 3)
"""Taps of the registers besides tap 0."""


@dataclass(frozen=True, eq=False)
class ResourceGrid:
    """Symbols of a frame.

    Attributes
    ----------
    symbols : ndarray of complex128, shape (n_subcarriers, n_symbols)
        Symbol of every resource element, unit mean power, read-only. The
        subcarriers of a symbol lie side by side in memory.
    is_prs : ndarray of bool, same shape
        True where an element carries the PRS; all others carry data.
    bits : ndarray of uint8, shape (n_bits,)
        Data, in the order of the resource elements that carry it: symbol by
        symbol, the lowest subcarrier first.
    modulation : {"qpsk", "16qam", "64qam", "256qam"}
        Of the data.
    """

    symbols: Complex
    is_prs: Mask
    bits: NDArray[np.uint8]
    modulation: Modulation

    __repr__ = short_repr


def draw_grid(
    system: System, modulation: Modulation = "qpsk", *, trial: int = 0, seed: int = 0, n_id: int = 0
) -> ResourceGrid:
    """Draw the data of a frame and put the PRS between it.

    Parameters
    ----------
    trial, seed : int
        Trial and seed of the data, not negative. Each modulation has its own data.
    n_id : int
        Identity of the PRS sequence, 0 to 4095.

    Raises
    ------
    InputError
        If a value is not allowed.

    References
    ----------
    3GPP TS 38.211, 7.3.1.5 (order of mapping) and 7.4.1.7 (PRS).

    Examples
    --------
    >>> from isacbench.model.numerology import System
    >>> grid = draw_grid(System(), "16qam")
    >>> grid.bits.size == 4 * (2048 * 224 - 48 * 512)
    True
    """
    n_bits = bits_per_symbol(modulation)
    is_prs = prs_elements(system)
    n_data = is_prs.size - int(is_prs.sum())
    # Eight bits of every random byte.
    packed = random_stream("data", trial, seed, modulation).bytes(-(-n_data * n_bits // 8))
    bits = np.unpackbits(np.frombuffer(packed, dtype=np.uint8), count=n_data * n_bits)
    # Symbols by subcarriers, so that one mask writes them in the standard's order.
    by_symbol = prs_symbols(system, n_id).T.copy()
    by_symbol[~is_prs.T] = modulate_bits(bits, modulation)
    for array in (by_symbol, is_prs, bits):
        array.setflags(write=False)
    return ResourceGrid(by_symbol.T, is_prs, bits, modulation)


@lru_cache(maxsize=2, typed=True)
def prs_symbols(system: System, n_id: int = 0) -> Complex:
    """Compute the symbols of the positioning reference signal on the resource grid.

    Parameters
    ----------
    n_id : int
        Identity of the sequence, 0 to 4095.

    Returns
    -------
    ndarray of complex128, shape (n_subcarriers, n_symbols)
        QPSK of unit power on the elements of `isacbench.model.numerology.prs_elements`,
        0 elsewhere; read-only.

    Raises
    ------
    InputError
        If the identity is not allowed.

    References
    ----------
    3GPP TS 38.211, 7.4.1.7.2.
    """
    is_prs = prs_elements(system)
    require_n_id(n_id)
    by_symbol = np.zeros(is_prs.T.shape, dtype=np.complex128)
    for symbol in np.flatnonzero(is_prs.any(axis=0)):
        slot, symbol_of_slot = divmod(int(symbol), SLOT_SYMBOLS)
        bits = gold_sequence(prs_c_init(slot, symbol_of_slot, n_id), 2 * int(is_prs[:, symbol].sum()))
        by_symbol[symbol, is_prs[:, symbol]] = modulate_bits(bits, "qpsk")
    by_symbol.setflags(write=False)
    return by_symbol.T


def prs_c_init(slot: int, symbol: int, n_id: int) -> int:
    """Initial value of the Gold sequence of a PRS symbol, by slot of the frame and symbol of the slot.

    References
    ----------
    3GPP TS 38.211, 7.4.1.7.2.
    """
    high, low = divmod(n_id, 1024)
    return (2**22 * high + 2**10 * (SLOT_SYMBOLS * slot + symbol + 1) * (2 * low + 1) + low) % 2**31


def gold_sequence(c_init: int, length: int) -> NDArray[np.uint8]:
    """Generate the pseudo-random bits c(0), c(1), ... of an initial value from 0 to 2³¹ - 1.

    References
    ----------
    3GPP TS 38.211, 5.2.1.
    """
    first = _m_sequence([1, *[0] * (REGISTER - 1)], FIRST_TAPS, length)
    return first ^ _m_sequence([c_init >> bit & 1 for bit in range(REGISTER)], SECOND_TAPS, length)


def _m_sequence(start: list[int], taps: tuple[int, ...], length: int) -> NDArray[np.uint8]:
    """Bits (length,) behind the skipped ones: x(n + 31) is the sum of x(n) and of x(n + tap) modulo 2."""
    if not any(start):
        return np.zeros(length, dtype=np.uint8)
    from scipy.signal import max_len_seq  # only where it is needed: its import takes half a second

    bits, _ = max_len_seq(REGISTER, start, SKIPPED + length, taps)
    return bits[SKIPPED:].astype(np.uint8)


def require_n_id(n_id: object) -> None:
    """Refuse what is no identity of a PRS sequence, a whole number from 0 to 4095."""
    allowed = type(n_id) is int and 0 <= n_id <= LARGEST_N_ID
    require(allowed, "n_id", n_id, f"a whole number from 0 to {LARGEST_N_ID}")


@dataclass(frozen=True)
class FrameRates:
    """Bits that frames sent one after the other carry, free of errors.

    Attributes
    ----------
    n_data_bits : int
        Bits of the elements that the PRS leaves.
    bit_rate_bps : float
        Data bits over the time of all symbols with their prefixes; a suffix overlaps
        the next prefix.
    """

    n_data_bits: int
    bit_rate_bps: float

    def achievable_rate_bps(self, ber: ArrayLike) -> Floats:
        """Compute the rate up to which a code could make the decided bits free of errors.

        Parameters
        ----------
        ber : array_like, any shape
            Bit error rate of independent errors, from 0 to 1.
        """
        return self.bit_rate_bps * hard_decision_capacity(ber)


def frame_rates(system: System, modulation: Modulation) -> FrameRates:
    """Count the bits of a frame, and its bit rate.

    Examples
    --------
    >>> from isacbench.model.numerology import System
    >>> rates = frame_rates(System(), "256qam")
    >>> rates.n_data_bits, round(rates.bit_rate_bps / 1e9, 3)
    (3473408, 2.977)
    """
    n_data_bits = bits_per_symbol(modulation) * int((~prs_elements(system)).sum())
    return FrameRates(n_data_bits, n_data_bits / (system.n_symbols * system.symbol_time_s))


def hard_decision_capacity(ber: ArrayLike) -> Floats:
    """Capacity of the binary symmetric channel: the information in bits that a decided bit carries.

    An `InputError` where a bit error rate is not from 0 to 1.
    """
    rate = checked_array("ber", ber)
    require_all("ber", rate, (rate >= 0) & (rate <= 1), "numbers from 0 to 1")
    entropy = -(xlogy(rate, rate) + xlogy(1 - rate, 1 - rate)) / np.log(2)
    return 1 - entropy
