"""Places that echoes of an observation can come from, in the coordinates of atoms."""

from __future__ import annotations

from dataclasses import dataclass

from isacbench.checked_arrays import Floats, Mask
from isacbench.dsp.fitting.atoms import AtomMap
from isacbench.model.observation import Observation
from isacbench.model.region import Interval

TOLERANCE_M = 0.7
"""Distance outside the region at which places are searched: an atom there may belong inside."""


@dataclass(frozen=True, eq=False)
class Reach:
    """Region of an observation in Rayleigh cells.

    Attributes
    ----------
    cell_size : ndarray of float64, shape (4,)
        Rayleigh cell in range bins, Doppler bins, u and w.
    range_limits, doppler_limits : (float, float)
        First and last bin that echoes can peak in.
    """

    observation: Observation
    cell_size: Floats
    range_limits: Interval
    doppler_limits: Interval

    @classmethod
    def of(cls, observation: Observation, atom_map: AtomMap) -> Reach:
        """Read the limits of an observation.

        Parameters
        ----------
        atom_map : AtomMap
            Of its cells.
        """
        gate = observation.gate
        range_bins = atom_map.range_bins[gate.reachable_range]
        doppler_bins = atom_map.doppler_bins[gate.reachable_doppler]
        return cls(
            observation,
            atom_map.cell_size,
            (float(range_bins[0]), float(range_bins[-1])),
            (float(doppler_bins[0]), float(doppler_bins[-1])),
        )

    @property
    def direction_limits(self) -> tuple[Interval, Interval]:
        """Lowest and highest u and w in Rayleigh cells."""
        (least_u, most_u), (least_w, most_w) = self.observation.cosine_limits
        size_u, size_w = (float(size) for size in self.cell_size[2:])
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
        range_bin, _, u, w = (places * self.cell_size).T
        xyz = self.observation.positions_m(range_bin, u, w)
        return self.observation.region.contains(xyz, tolerance_m)
