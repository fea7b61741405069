"""Gold sequences of length 31, from which 5G draws what looks random and everybody knows."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from isacbench.errors import require
from isacbench.model.number_limits import require_count

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

REGISTER = 31
"""Bits that both m-sequences follow from."""

SKIPPED = 1600
"""Bits N_C of both m-sequences before the first that counts."""

FIRST_TAPS = (0, 3)
SECOND_TAPS = (0, 1, 2, 3)

STEP = REGISTER - max(SECOND_TAPS)
"""Bits that follow at once from those before: no tap reaches one that is not there yet."""


def gold_sequence(c_init: ArrayLike, length: int) -> NDArray[np.uint8]:
    """Pseudo-random bits c(0), c(1), ... of one or several initial values.

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
    second = (values.astype(np.int64)[..., None] >> np.arange(REGISTER)) & 1
    first = np.zeros(REGISTER, dtype=np.uint8)
    first[0] = 1
    n_bits = SKIPPED + length
    bits = _m_sequence(first, FIRST_TAPS, n_bits) ^ _m_sequence(second.astype(np.uint8), SECOND_TAPS, n_bits)
    return bits[..., SKIPPED:]


def _m_sequence(start: NDArray[np.uint8], taps: tuple[int, ...], length: int) -> NDArray[np.uint8]:
    """Sequences (..., length) that go on from (..., 31) bits: x(n + 31) is the sum of x(n + tap) modulo 2."""
    bits = np.zeros((*start.shape[:-1], max(length, REGISTER)), dtype=np.uint8)
    bits[..., :REGISTER] = start
    for first in range(REGISTER, length, STEP):
        stop = min(first + STEP, length)
        base = first - REGISTER
        bits[..., first:stop] = np.bitwise_xor.reduce(
            [bits[..., base + tap : base + tap + stop - first] for tap in taps]
        )
    return bits[..., :length]
