"""Gold sequences of length 31: the pseudo-random bits of 5G reference signals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import max_len_seq

from isacbench.errors import require
from isacbench.model.number_limits import require_count

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

REGISTER = 31
"""Bits in the register of either m-sequence."""

SKIPPED = 1600
"""Bits N_C that both m-sequences drop at their start."""

FIRST_TAPS = (3,)
SECOND_TAPS = (1, 2, 3)
"""Taps of the registers besides tap 0."""


def gold_sequence(c_init: ArrayLike, length: int) -> NDArray[np.uint8]:
    """Generate the pseudo-random bits c(0), c(1), ... of one or several initial values.

    Parameters
    ----------
    c_init : array_like of int, any shape
        Initial values of the second m-sequence, 0 to 2³¹ - 1.
    length : int
        Bits of each sequence.

    Returns
    -------
    ndarray of uint8, shape (*c_init.shape, length)
        Zeros and ones.

    Raises
    ------
    InputError
        If an initial value or the length is out of range.

    References
    ----------
    3GPP TS 38.211, 5.2.1.

    Examples
    --------
    >>> gold_sequence(1, 8).tolist()
    [0, 0, 0, 0, 0, 0, 1, 0]
    """
    values = np.asarray(c_init)
    integral = values.dtype.kind in "iu" and bool(np.all((values >= 0) & (values < 2**REGISTER)))
    require(integral, "c_init", c_init, f"whole numbers from 0 to {2**REGISTER - 1}")
    require_count("length", length, smallest=0)
    first = _m_sequence([1, *[0] * (REGISTER - 1)], FIRST_TAPS, length)
    bits = np.empty((*values.shape, length), dtype=np.uint8)
    for place, value in np.ndenumerate(values):
        start = [int(value) >> bit & 1 for bit in range(REGISTER)]
        bits[place] = first ^ _m_sequence(start, SECOND_TAPS, length)
    return bits


def _m_sequence(start: list[int], taps: tuple[int, ...], length: int) -> NDArray[np.uint8]:
    """Bits (length,) behind the skipped ones: x(n + 31) is the sum of x(n) and of x(n + tap) modulo 2."""
    if not any(start):
        return np.zeros(length, dtype=np.uint8)
    bits, _ = max_len_seq(REGISTER, start, SKIPPED + length, taps)
    sequence: NDArray[np.uint8] = bits[SKIPPED:].astype(np.uint8)
    return sequence
