"""Unit of amplitudes: a power of two that keeps squares inside the floating-point range."""

from __future__ import annotations

import numpy as np

from isacbench.checked_arrays import Complex
from isacbench.errors import require

MOST_EXPONENT = 40
"""Amplitudes beyond 2^40 or its reciprocal have a unit of their own: single precision lacks their squares."""

LIMIT = 2.0**510
"""Amplitudes from here on, 3e153, have powers that overflow; powers that underflow are 0."""


def scale_to_unit(cells: Complex) -> tuple[Complex, float]:
    """Divide finite cells by a power of two near their largest amplitude, exactly; return them and that unit.

    The unit is 1, and the array itself is returned, where the squares of all amplitudes are harmless. An
    `InputError` if powers would overflow.
    """
    parts = np.ascontiguousarray(cells).view(cells.real.dtype)
    largest = float(max(parts.max(initial=0), -parts.min(initial=0)))
    require(largest < LIMIT, "observation: its largest amplitude", largest, f"less than {LIMIT:g}")
    exponent = int(np.frexp(largest)[1])
    if abs(exponent) <= MOST_EXPONENT:
        return cells, 1.0
    return np.ldexp(parts, -exponent).view(cells.dtype), float(np.ldexp(1.0, exponent))
