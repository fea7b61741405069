"""Truth merged in Rayleigh cells, averaged over places of their lattice: a limit of resolution.

The cells are the radio's own: a range bin, a velocity bin, and 2/P and 2/Q in direction cosine (2/16 on
the 16 x 16 array). The number of merged scatterers depends on where the borders of the cells lie. The
lattice of cells is therefore moved by 64 fixed offsets, and scores are means over the 64 clouds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isacbench.checked_arrays import Floats
from isacbench.errors import require
from isacbench.model.cloud import PointCloud
from isacbench.model.radio_coordinates import Radio, radio_places, rayleigh_cells

from .bases.references import N_REALISATIONS, Reference

GENERATOR = (1, 3, 11, 29)
"""Generator of the rank-1 lattice of offsets. It has the least P_2 of all odd generators, 3.67; for random
offsets 5.28 is expected. Its squared wrap-around L2 discrepancy is 0.0034; random offsets have 0.029."""


def lattice_offsets() -> Floats:
    """Offsets of the lattice of cells: a rank-1 lattice in four dimensions.

    Returns
    -------
    ndarray of float64, shape (64, 4)
        In cells, along range, velocity, u and w. Each column has every odd multiple of 1/128
        below 1 once.

    References
    ----------
    Sloan and Joe, "Lattice Methods for Multiple Integration", 1994: rank-1 lattices and P_2.
    """
    steps = np.arange(N_REALISATIONS)[:, None] * np.array(GENERATOR) % N_REALISATIONS
    return (steps + 0.5) / N_REALISATIONS


@dataclass(frozen=True)
class Oracle(Reference):
    """Truth at the radio's resolution: scatterers of one Rayleigh cell become their centroid.

    Attributes
    ----------
    cell : float
        Size of a cell in Rayleigh cells, along each of range, velocity, u and w.

    Raises
    ------
    InputError
        If the size is no positive number.
    """

    cell: float = 1.0

    name: ClassVar[str] = "oracle"

    def __post_init__(self) -> None:
        require(0 < self.cell < np.inf, "cell", self.cell, "a positive number of Rayleigh cells")

    def realisations(self, radio: Radio, truth: PointCloud) -> list[PointCloud]:
        """Merge the truth in the cells of each of the 64 lattices.

        Parameters
        ----------
        radio : Radio
            Scenario or observation.

        Returns
        -------
        list of PointCloud
            Centroids in x, y, z and v; the powers of a cell are summed.
        """
        places = radio_places(radio, truth) / (self.cell * rayleigh_cells(radio))
        points = truth.to_array()
        return [
            PointCloud.from_array(_merged(points, np.floor(places + offset))) for offset in lattice_offsets()
        ]


def _merged(points: Floats, cells: Floats) -> Floats:
    """Merge points (n, 5) of equal cells (n, 4): means of x, y, z and v, sums of the power."""
    if not len(points):
        return points
    order = np.lexsort(cells.T)
    ordered = cells[order]
    is_first = np.r_[True, (ordered[1:] != ordered[:-1]).any(axis=1)]
    starts = np.flatnonzero(is_first)
    merged: Floats = np.add.reduceat(points[order], starts, axis=0)
    merged[:, :4] /= np.diff(starts, append=len(points))[:, None]
    return merged
