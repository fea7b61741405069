"""Gathering of grid atoms into scatterers."""

from __future__ import annotations

import numpy as np

from isacbench.dsp.array_types import Complex, Floats

PITCH = 2.0**-10
"""Rayleigh cells to which centroids are rounded: single precision and few learning steps leave finer digits
undetermined, and joint steps would magnify them."""


def gather(places: Floats, amplitude: Complex | Floats, box: Floats) -> tuple[Floats, Floats]:
    """Unite neighbouring atoms: one off the grid is spread over several on it.

    The strongest atom gathers all within a box around it, then the strongest of
    the rest, and so on.

    Parameters
    ----------
    places : ndarray of float64, shape (n, 4)
        In Rayleigh cells.
    amplitude : ndarray of complex128 or float64, shape (n,)
    box : ndarray of float64, shape (4,)
        Half widths of the box.

    Returns
    -------
    places : ndarray of float64, shape (m, 4)
        Centroids, weighted with |amplitude|, to a thousandth of a cell; the
        strongest atom's first.
    strength : ndarray of float64, shape (m,)
        |sum of the amplitudes|.

    Examples
    --------
    >>> places = np.array([[1.0, 0, 0, 0], [1.1, 0, 0, 0], [2, 0, 0, 0]])
    >>> gathered, strength = gather(places, np.array([3.0, 1, 2]), np.full(4, 0.2))
    >>> gathered[:, 0].round(3), strength
    (array([1.025, 2.   ]), array([4., 2.]))
    """
    weight = np.abs(amplitude)
    free = np.ones(weight.size, dtype=np.bool_)
    centres, strengths = [], []
    for atom in np.argsort(-weight, kind="stable"):
        if not free[atom]:
            continue
        near = free & np.all(np.abs(places - places[atom]) <= box, axis=1)
        centres.append(weight[near] @ places[near] / weight[near].sum())
        strengths.append(abs(amplitude[near].sum()))
        free &= ~near
    centroids = np.array(centres).reshape(-1, places.shape[1])
    return np.rint(centroids / PITCH) * PITCH, np.array(strengths)


def strongest_near(places: Floats, amplitude: Floats, reach: tuple[float, float]) -> Floats:
    """Largest amplitude within some range and Doppler bins of each atom, its own included.

    Parameters
    ----------
    places : ndarray of float64, shape (n, 4)
        In Rayleigh cells.
    amplitude : ndarray of float64, shape (n,)
    reach : (float, float)
        Range and Doppler bins.

    Returns
    -------
    ndarray of float64, shape (n,)
    """
    distance = np.abs(places[:, None, :2] - places[:, :2])
    near = np.all(distance < reach, axis=2)
    strongest: Floats = np.where(near, amplitude, 0).max(axis=1, initial=0)
    return strongest
