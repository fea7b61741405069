"""Ties: numbers that only rounding tells apart, and that come in one order however they were rounded.

Equal echoes have equal powers but for their last digits, which threads, memory
order and units change. Where the order of powers decides, they are compared to
fewer digits, and what is equal then keeps the order it has.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["rounded"]

Floats = NDArray[np.float64]


def rounded(values: Floats, digits: int) -> Floats:
    """Values to so many decimal digits of their binary mantissa, in any unit the same.

    Parameters
    ----------
    values : ndarray of float64
    digits : int

    Returns
    -------
    ndarray of float64, same shape

    Examples
    --------
    >>> first, second = rounded(np.array([0.1 + 0.2, 0.3]), 9)
    >>> bool(first == second)
    True
    """
    mantissa, exponent = np.frexp(values)
    few: Floats = np.ldexp(np.round(mantissa, digits), exponent)
    return few
