"""The unit of amplitudes: a power of two that keeps squares inside the floating-point range."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from isacbench.errors import require

Complex = NDArray[np.complexfloating[Any, Any]]

MOST_EXPONENT = 40
"""Amplitudes beyond 2^40 or its reciprocal have a unit of their own: single precision lacks their squares."""

GREATEST_EXPONENT = 510
"""Amplitudes from 2^510, 3e153, have powers that are no numbers; where powers are too small, they are 0."""


def amplitude_exponent(cells: Complex) -> int:
    """Power of two near the largest amplitude of a map; 0 where its squares are harmless as they are.

    Parameters
    ----------
    cells : ndarray of complex, shape (n_range, n_doppler, *elements)
        Finite. All are looked at: one element may be far stronger than the others.

    Returns
    -------
    int

    Raises
    ------
    InputError
        If powers would be beyond what numbers hold.

    Examples
    --------
    >>> amplitude_exponent(np.full((2, 2, 1), 3e100 + 0j)), amplitude_exponent(np.full((2, 2, 1), 1e9 + 0j))
    (334, 0)
    """
    largest = _largest_part(cells)
    limit = 2.0**GREATEST_EXPONENT
    require(largest < limit, "observation: its largest amplitude", largest, f"less than {limit:g}")
    _, exponent = np.frexp(largest)
    return 0 if abs(exponent) <= MOST_EXPONENT else int(exponent)


def _largest_part(cells: Complex) -> float:
    """Largest real or imaginary part, which overflows nowhere."""
    parts = np.ascontiguousarray(cells).view(cells.real.dtype)
    return float(max(parts.max(initial=0), -parts.min(initial=0)))


def in_unit(cells: Complex, exponent: int) -> Complex:
    """Cells in units of a power of two: itself for 0, else a copy, of the same precision and exact.

    Parameters
    ----------
    cells : ndarray of complex
    exponent : int

    Returns
    -------
    ndarray of complex

    Examples
    --------
    >>> in_unit(np.array([3e100 + 0j]), 334).real.round(3).tolist()
    [0.857]
    """
    if exponent == 0:
        return cells
    scaled = np.array(cells, order="C")
    parts = scaled.view(scaled.real.dtype)
    np.ldexp(parts, -exponent, out=parts)
    return scaled
