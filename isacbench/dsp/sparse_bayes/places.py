"""Places of atoms: where echoes of an observation can come from, and what lies together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from isacbench.checked_arrays import Complex, Floats, Mask
from isacbench.dsp.fitting.atoms import AtomMap
from isacbench.model.observation import Observation
from isacbench.model.region import Interval

TOLERANCE_M = 0.7
"""Distance outside the region at which places are searched: an atom there may belong inside."""

PITCH = 2.0**-12 * (1 + np.sqrt(5))
"""Rayleigh cells to which centroids are rounded: joint steps would magnify digits that rounding decides. By
the golden ratio no place with few binary digits, which settled atoms have, is halfway between two of them,
and mirrored places are rounded alike."""

SAME_DIRECTION_CELLS = 0.5
"""Distance in u and w up to which the misfit of an atom is as strong as beside it."""

LEAST_MISFIT_DB = 14.0
"""Most by which the misfit of an atom falls towards other directions."""


@dataclass(frozen=True, eq=False)
class Reach:
    """Region of an observation in Rayleigh cells.

    Attributes
    ----------
    atom_map : AtomMap
        Of its cells.
    """

    observation: Observation
    atom_map: AtomMap

    @property
    def range_limits(self) -> Interval:
        """First and last range bin that echoes can peak in."""
        bins = self.atom_map.range_bins[self.observation.gate.reachable_range]
        return float(bins[0]), float(bins[-1])

    @property
    def doppler_limits(self) -> Interval:
        """First and last Doppler bin that echoes can peak in."""
        bins = self.atom_map.doppler_bins[self.observation.gate.reachable_doppler]
        return float(bins[0]), float(bins[-1])

    @property
    def direction_limits(self) -> tuple[Interval, Interval]:
        """Lowest and highest u and w in Rayleigh cells."""
        (least_u, most_u), (least_w, most_w) = self.observation.cosine_limits
        size_u, size_w = (float(size) for size in self.atom_map.cell_size[2:])
        return (least_u / size_u, most_u / size_u), (least_w / size_w, most_w / size_w)

    def contains(self, places: Floats, tolerance_m: float = TOLERANCE_M) -> Mask:
        """Tell which places lie in the region; their Doppler is not looked at.

        Parameters
        ----------
        places : ndarray of float64, shape (n, 4)
            In Rayleigh cells.
        tolerance_m : float
            Largest distance outside.

        Returns
        -------
        ndarray of bool, shape (n,)
        """
        range_bin, _, u, w = (places * self.atom_map.cell_size).T
        xyz = self.observation.positions_m(range_bin, u, w)
        return self.observation.region.contains(xyz, tolerance_m)


def merge_neighbours(places: Floats, amplitude: Complex | Floats, box: Floats) -> tuple[Floats, Floats]:
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
    >>> gathered, strength = merge_neighbours(places, np.array([3.0, 1, 2]), np.full(4, 0.2))
    >>> gathered[:, 0].round(3), strength
    (array([1.025, 2.   ]), array([4., 2.]))
    """
    order = np.argsort(-np.abs(amplitude), kind="stable")
    # One row a coordinate, strongest first: what is left shrinks with every centre.
    along, amplitude = places[order].T, amplitude[order]
    centres, strengths = [], []
    while amplitude.size:
        near = np.ones(amplitude.size, dtype=np.bool_)
        for coordinate, half_width in zip(along, box, strict=True):
            near &= np.abs(coordinate - coordinate[0]) <= half_width
        weight = np.abs(amplitude[near])
        centres.append(along[:, near] @ weight / weight.sum())
        strengths.append(abs(amplitude[near].sum()))
        along, amplitude = along[:, ~near], amplitude[~near]
    centroids = np.array(centres).reshape(-1, places.shape[1])
    return np.rint(centroids / PITCH) * PITCH, np.array(strengths)


def strongest_near(places: Floats, amplitude: Floats, reach: tuple[float, float]) -> Floats:
    """Largest amplitude that atoms within some range and Doppler bins show at each atom, its own included.

    Beyond half a cell along u or w an atom counts with the envelope of its sidelobes, 1 / π d, but never with
    less than `LEAST_MISFIT_DB` below its amplitude: its misfit has every direction. Places (n, 4) are in
    Rayleigh cells.
    """
    along_range, along_doppler = places[:, 0], places[:, 1]
    near = np.abs(along_range[:, None] - along_range) < reach[0]
    near &= np.abs(along_doppler[:, None] - along_doppler) < reach[1]
    one, other = np.nonzero(near)
    across = np.abs(places[one, 2:] - places[other, 2:])
    drop = np.maximum(np.pi * (across - SAME_DIRECTION_CELLS), 1).prod(axis=1)
    strongest = np.zeros(len(places))
    np.maximum.at(strongest, one, amplitude[other] / np.minimum(drop, 10 ** (LEAST_MISFIT_DB / 20)))
    return strongest
