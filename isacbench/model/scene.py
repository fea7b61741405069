"""The scene: scatterers, and the scenario that adds the radio and the region to them."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from isacbench.errors import InputError, InputWarning
from isacbench.model.cloud import PointCloud
from isacbench.model.frozen import freeze_arrays

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from isacbench.model.array import VirtualArray
    from isacbench.model.frame import Frame
    from isacbench.model.numerology import System
    from isacbench.model.region import Region

__all__ = ["Scatterers", "Scenario"]


@dataclass(frozen=True, eq=False)
class Scatterers:
    """Point scatterers of a scene.

    Attributes
    ----------
    xyz : ndarray of float64, shape (n, 3)
        Positions in metres.
    velocity : ndarray of float64, shape (n,)
        Radial velocities in m/s, positive when approaching.
    amplitude : ndarray of float64, shape (n,)
        Echo amplitudes |G|, 1 for a unit scatterer.
    phase_rad : ndarray of float64, shape (n,)
        Phases of the echoes, to which a coherent system adds the carrier's;
        0 unless given.
    """

    xyz: NDArray[np.float64]
    velocity: NDArray[np.float64]
    amplitude: NDArray[np.float64]
    phase_rad: NDArray[np.float64] = field(default_factory=lambda: np.zeros(()))

    def __post_init__(self) -> None:
        freeze_arrays(self, "xyz", "velocity", "amplitude")
        object.__setattr__(self, "phase_rad", np.broadcast_to(self.phase_rad, self.velocity.shape))
        freeze_arrays(self, "phase_rad")

    def __len__(self) -> int:
        return self.velocity.size


@dataclass(frozen=True, eq=False)
class Scenario:
    """Everything that an echo follows from, bar the noise.

    Attributes
    ----------
    name : str
    system : System
    array : VirtualArray
    frame : Frame
    base_station_m : ndarray of float64, shape (3,)
    region : Region
    scatterers : Scatterers

    Raises
    ------
    InputError
        If the region cannot be observed unambiguously, or a scatterer or the
        whole region lies where the array is blind.

    Warns
    -----
    InputWarning
        If scatterers lie outside the region.
    """

    name: str
    system: System
    array: VirtualArray
    frame: Frame
    base_station_m: NDArray[np.float64]
    region: Region
    scatterers: Scatterers

    def __post_init__(self) -> None:
        freeze_arrays(self, "base_station_m")
        self._require_unambiguous_region()
        self._require_sight()
        self._warn_of_strays()

    def _require_unambiguous_region(self) -> None:
        system, region = self.system, self.region
        if min(self.array.shape) < 2:
            n_p, n_q = self.array.shape
            raise InputError(
                f"array: its {n_p} x {n_q} virtual elements see no direction; "
                "allowed are 2 and more along u and w"
            )
        farthest_m = region.range_limits_m(self.base_station_m)[1]
        if farthest_m > system.unambiguous_range_m:
            raise InputError(
                f"region: its farthest corner is {farthest_m:.1f} m from the base station, beyond the "
                f"unambiguous range; allowed are at most {system.unambiguous_range_m:.1f} m, which is "
                "c / (2 subcarrier_spacing_hz)"
            )
        fastest_mps = max(abs(speed) for speed in region.speed_mps)
        if fastest_mps > system.unambiguous_speed_mps:
            raise InputError(
                f"region.speed_mps: {fastest_mps:g} m/s is beyond the unambiguous speed; allowed are at most "
                f"{system.unambiguous_speed_mps:.1f} m/s"
            )

    def _require_sight(self) -> None:
        corners_m = self.region.corners_m - self.base_station_m
        if not self.frame.in_half_space(corners_m).any():
            raise InputError(
                f"region: it lies where the array is blind; allowed are places {self.frame.half_space}"
            )
        offset_m = self.scatterers.xyz - self.base_station_m
        blind = ~self.frame.in_half_space(offset_m) | ~offset_m.any(axis=1)
        if blind.any():
            x, y, z = self.scatterers.xyz[np.argmax(blind)]
            raise InputError(
                f"objects: {blind.sum()} of {blind.size} scatterers, the first at ({x:g}, {y:g}, {z:g}) m, "
                f"lie where the array is blind; allowed are places {self.frame.half_space}"
            )

    def _warn_of_strays(self) -> None:
        scatterers, (lowest_mps, highest_mps) = self.scatterers, self.region.speed_mps
        inside = self.region.contains(scatterers.xyz)
        inside &= (scatterers.velocity >= lowest_mps) & (scatterers.velocity <= highest_mps)
        if not inside.all():
            warnings.warn(
                f"scenario {self.name}: {np.sum(~inside)} of {inside.size} scatterers lie outside the region "
                "or its speeds, where no estimator looks",
                InputWarning,
                stacklevel=4,
            )

    @property
    def truth(self) -> PointCloud:
        """The scatterers as a point cloud, power |G|²."""
        scatterers = self.scatterers
        return PointCloud(scatterers.xyz, scatterers.velocity, scatterers.amplitude**2)
