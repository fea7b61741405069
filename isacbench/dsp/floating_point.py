"""Floating-point numbers: a unit for amplitudes, and an order that rounding does not decide.

Equal echoes have equal powers but for their last digits, which threads, memory
order and units change. Powers whose order decides are compared to fewer
digits, and those equal then keep their order.
"""

from __future__ import annotations

import numpy as np

from isacbench.checked_arrays import Complex, Floats
from isacbench.errors import require

MOST_EXPONENT = 40
"""Amplitudes beyond 2^40 or its reciprocal have a unit of their own: single precision lacks their squares."""

LIMIT = 2.0**510
"""Amplitudes from here on, 3e153, have powers that overflow; powers that underflow are 0."""

STEP_BITS = 8
"""Binary digits kept below the square of a step."""


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


def round_mantissa(values: Floats, digits: int) -> Floats:
    """Round values to decimal digits of their binary mantissa.

    Returns
    -------
    ndarray of float64, same shape

    Examples
    --------
    >>> first, second = round_mantissa(np.array([0.1 + 0.2, 0.3]), 9)
    >>> bool(first == second)
    True
    """
    mantissa, exponent = np.frexp(values)
    return np.ldexp(np.round(mantissa, digits), exponent)


def round_step(places: Floats, steps: Floats) -> Floats:
    """Round places after a step to the digits that the step determines.

    A Newton step of length s ends about s² from its aim, in units in which the
    curvature changes by its own size. Digits far below s² carry rounding alone,
    and the next steps would magnify it: results of two processors whose sums
    differ in the last digit would part. Near its aim a step is short, and the
    digits stay.

    Parameters
    ----------
    places : ndarray of float64, shape (..., m)
        In Rayleigh cells.
    steps : ndarray of float64, shape (..., m)
        Steps to these places. All coordinates keep the digits of the longest.

    Returns
    -------
    ndarray of float64, shape (..., m)

    Examples
    --------
    >>> round_step(np.array([0.123456789, 0.5]), np.array([0.1, 0.0]))
    array([0.12347412, 0.5       ])
    >>> round_step(np.array([0.123456789]), np.array([1e-8]))
    array([0.12345679])
    """
    longest = np.abs(steps).max(axis=-1, keepdims=True, initial=0)
    _, exponent = np.frexp(longest)
    pitch = np.ldexp(1.0, np.where(longest > 0, 2 * exponent - STEP_BITS, -1000))
    return np.rint(places / pitch) * pitch
