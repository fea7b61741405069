"""Order of numbers that differ by rounding alone, the same on every processor.

Equal echoes have equal powers but for their last digits, which threads, memory
order and units change. Powers whose order decides are compared to fewer
digits, and those equal then keep their order.
"""

from __future__ import annotations

import numpy as np

from isacbench.checked_arrays import Floats

STEP_BITS = 8
"""Binary digits kept below the square of a step."""


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
