"""Limits of the numbers that describe a scene, within which every power of them is an ordinary double.

Within these limits echo, observation, cloud and scores are finite. Beyond them
doubles hold neither the power of an echo nor its phase, and nothing sensible
could be said: that is refused where it comes in.
"""

from __future__ import annotations

import operator
from typing import SupportsIndex, cast

import numpy as np
from numpy.typing import ArrayLike

from isacbench.errors import InputError, require

LARGEST_AMPLITUDE = 1e152
"""Of all echoes of a scene together, the root of their power: thousands of 1e150 each."""

SMALLEST_AMPLITUDE = 1e-152
"""Of a scene that is not silent; single echoes may be weaker."""

LARGEST_NOISE_AMPLITUDE = 1e153
"""Root of the noise power per resource element: noise has no gain."""

LARGEST_PLACE_M = 1e9
"""Farthest coordinate: a million kilometres, where neighbouring doubles are a tenth of a micrometre apart."""

LARGEST_COUNT = 2**31
"""Most subcarriers, symbols or elements along an axis."""


def require_places(name: str, values: ArrayLike) -> None:
    """Refuse coordinates in metres that are not finite or beyond a million kilometres.

    Raises
    ------
    InputError
        Naming them and the first that is not allowed.
    """
    limit = LARGEST_PLACE_M
    require_all(name, values, np.abs(values) <= limit, f"finite coordinates in m, at most {limit:g}")


def require_all(name: str, values: ArrayLike, allowed: ArrayLike, limits: str) -> None:
    """Refuse numbers of which some are not allowed, naming the first one and, in words, the limits."""
    faulty = ~np.asarray(allowed, dtype=np.bool_)
    if faulty.any():
        raise InputError(f"{name} holds {np.asarray(values)[faulty].flat[0]:g}; allowed are {limits}")


def require_interval(name: str, limits: tuple[float, float], largest: float) -> None:
    """Refuse limits that are not two ascending numbers up to some magnitude."""
    values = np.asarray(limits, dtype=np.float64)
    fits = values.shape == (2,) and bool(-largest <= values[0] <= values[1] <= largest)
    require(fits, name, limits, f"two ascending numbers, none beyond {largest:g}")


def require_count(name: str, value: object) -> None:
    """Refuse a value that is not a whole number from 1 up."""
    fits = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    fits = fits and 1 <= operator.index(cast("SupportsIndex", value)) <= LARGEST_COUNT
    require(fits, name, value, f"a whole number from 1 to {LARGEST_COUNT}")
