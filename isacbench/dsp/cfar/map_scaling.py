"""Powers near the ends of float64: maps are tested scaled by a power of two, which is exact.

Sums over a window overflow long before its mean does, and a mean of subnormal
numbers keeps no digits: that of one cell in ten with the smallest of them is 0,
and so is its threshold, which that cell then exceeds. A map whose strongest cell
lies beyond `LARGEST` or below `SMALLEST` is therefore scaled, tested, and its
noise and thresholds are scaled back.

A threshold is rounded to the next float64 *below* where it has to be rounded on
the way back: a power exceeds that exactly where it exceeds the threshold itself.
The same holds above the largest float64, which no power exceeds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from isacbench.dsp.cfar.map_checks import checked_extent
from isacbench.dsp.detection import Detection

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]

LARGEST, SMALLEST = 2.0**959, 2.0**-512
"""Strongest cell of the maps that are tested as they are."""

_DOWN, _UP = -64, 512
"""Exponents of the powers of two for the others: sums of 2^63 cells stay finite, no cell stays subnormal."""

_MOST = float(np.finfo(np.float64).max)


@dataclass(frozen=True, eq=False)
class ScaledMap:
    """A power map as it was given, and scaled for the test.

    Attributes
    ----------
    given : ndarray of float64
        Power map of any rank.
    values : ndarray of float64
        The same times 2^exponent; the same array where the exponent is 0.
    exponent : int
    """

    given: Floats
    values: Floats
    exponent: int

    @classmethod
    def of(cls, power: ArrayLike, looks: int, sums: bool = True) -> ScaledMap:
        """Check a map and scale it.

        Parameters
        ----------
        power : array_like of real numbers
            Power map of any rank.
        looks : int
            Independent noise powers that each cell averages.
        sums : bool, default True
            Whether cells are added: large ones need no scaling otherwise.

        Raises
        ------
        InputError
            As `isacbench.dsp.cfar.map_checks.checked_power` does.
        """
        given, strongest = checked_extent(power, looks)
        exponent = 0
        if 0 < strongest < SMALLEST:
            exponent = _UP
        elif sums and strongest > LARGEST:
            exponent = _DOWN
        return cls(given, np.ldexp(given, exponent) if exponent else given, exponent)

    def unscaled(self, found: Detection, cells: Sequence[ArrayLike] | None = None) -> Detection:
        """Give what was found in the scaled map for the one that was given, or for listed cells of it."""
        if self.exponent == 0:
            return found
        threshold = unscaled_threshold(found.threshold, self.exponent)
        # Cells that lose digits when a map is scaled down are compared in full.
        power = self.given if cells is None else self.given[tuple(np.asarray(index) for index in cells)]
        return Detection(power > threshold, threshold, unscaled_noise(found.noise, self.exponent))


def unscaled_noise(noise: Floats, exponent: int) -> Floats:
    """Scale noise back, rounded to the nearest; a mean is never above its largest cell."""
    return noise if exponent == 0 else at_most_largest(_shifted(noise, -exponent))


def unscaled_threshold(threshold: Floats, exponent: int) -> Floats:
    """Scale thresholds back, rounded down."""
    if exponent == 0:
        return threshold
    nearest = at_most_largest(_shifted(threshold, -exponent))
    above = _shifted(nearest, exponent) > threshold
    return np.where(above, np.nextafter(nearest, 0.0), nearest)


def at_most_largest(values: Floats) -> Floats:
    """Replace what has overflowed by the largest float64, in place."""
    if values.max(initial=0.0) == math.inf:
        np.minimum(values, _MOST, out=values)
    return values


def _shifted(values: Floats, exponent: int) -> Floats:
    """Multiply by a power of two; what overflows is infinite."""
    with np.errstate(over="ignore", under="ignore"):
        shifted: Floats = np.ldexp(values, exponent)
    return shifted
