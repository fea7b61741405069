"""Direction cosines on their circle: elements half a wavelength apart do not tell u from u + 2."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from isacbench.checked_arrays import Floats
from isacbench.model.region import Interval

Spectra = TypeVar("Spectra", bound=NDArray[Any])

PERIOD = 2.0


def within_period(cosine: Floats) -> Floats:
    """Cosines from -1 to 1 of the same plane waves.

    Returns
    -------
    ndarray of float64, same shape
        Those from -1 to 1 stay as they are.
    """
    return cosine - PERIOD * np.rint(cosine / PERIOD)


def cosine_samples(limits: Interval, widest: float) -> Floats:
    """Sample direction cosines between two limits and once beyond either, or the whole circle.

    The circle is sampled where the samples beyond the limits would meet or
    overlap: a plane wave then has one place among them, not two.

    Parameters
    ----------
    limits : (float, float)
        Lowest and highest cosine.
    widest : float
        Largest distance of two samples.

    Returns
    -------
    ndarray of float64, shape (g,)
        Equidistant; the limits are the second and the last but one, but for
        the circle, which begins at -1.
    """
    span = limits[1] - limits[0]
    n_steps = max(int(np.ceil(span / widest * (1 - np.finfo(np.float64).eps))), 1)
    step = span / n_steps or widest
    if span + 2 * step >= PERIOD:
        n_steps = int(np.ceil(PERIOD / step))
        return np.linspace(-1, 1, n_steps, endpoint=False)
    return np.linspace(limits[0] - step, limits[0] + (n_steps + 1) * step, n_steps + 3)


def with_neighbours(spectra: Spectra, grids: Sequence[Floats]) -> tuple[Spectra, list[Floats]]:
    """Give spectra over a whole circle the samples beyond either end that other spectra have.

    Parameters
    ----------
    spectra : ndarray, shape (n, *samples)
    grids : sequence of ndarray of float64
        Cosines along each axis, from `cosine_samples`.

    Returns
    -------
    spectra : ndarray
        With the last sample before the first, and the first behind the last, along circles.
    grids : list of ndarray of float64
        Cosines of these samples.
    """
    framed = []
    for axis, grid in enumerate(grids, start=1):
        step = grid[1] - grid[0]
        if abs(grid.size * step - PERIOD) < step / 2:
            sides = [(1, 1) if one == axis else (0, 0) for one in range(spectra.ndim)]
            spectra = np.pad(spectra, sides, mode="wrap")  # type: ignore[assignment]
            grid = np.r_[grid[0] - step, grid, grid[-1] + step]
        framed.append(grid)
    return spectra, framed
