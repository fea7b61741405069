"""Objects of a scenario file: their keys, and the scatterers that they stand for."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from isacbench.files.checked_files import require_inside
from isacbench.model.cloud_files.point_files import read_points_csv
from isacbench.model.scene import Scatterers
from isacbench.model.scenes.motion import DECIMALS, approach_speeds, body_velocities, heading, turned
from isacbench.model.scenes.objects import (
    RIM,
    box,
    car,
    green_belt,
    lamp_post,
    limb_swing,
    pedestrian,
    pole,
    rail,
    vehicle,
    wall,
    wheel_roll,
)

if TYPE_CHECKING:
    from pathlib import Path

# Strict, because a number in quotes or a `true` for a number is a typing error.
Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[Finite, Field(gt=0)]
NonNegative = Annotated[Finite, Field(ge=0)]
Position = tuple[Finite, Finite, Finite]
Size = tuple[Positive, Positive, Positive]
Offsets = NDArray[np.float64]


def _speed_or_vector(value: Any) -> float | tuple[float, ...]:
    """Take a radial speed or a velocity vector."""
    values = value if isinstance(value, list | tuple) else [value]
    are_numbers = all(type(one) in (int, float) and math.isfinite(one) for one in values)
    if not are_numbers or len(values) not in ({3} if values is value else {1}):
        raise ValueError("allowed is a radial speed, positive when approaching, or a vector [x, y, z]")
    return tuple(map(float, values)) if values is value else float(value)


Velocity = Annotated[Any, AfterValidator(_speed_or_vector)]


class FileTable(BaseModel):
    """Table of a file, without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class _ObjectTable(FileTable):
    position_m: Position
    velocity_mps: Velocity = 0.0
    amplitude: Positive = 1.0
    yaw_deg: Finite = 0.0
    yaw_rate_dps: Finite = 0.0

    outline: ClassVar[Callable[..., Offsets]]
    """Gives scatterer positions (n, 3) around `position_m` from the keys of the kind."""

    @model_validator(mode="after")
    def _require_vector(self) -> Self:
        if self.yaw_rate_dps and not isinstance(self.velocity_mps, tuple):
            raise ValueError("yaw_rate_dps needs velocity_mps as a vector [x, y, z]")
        return self

    def scatterers(self, source: Path, base_station_m: Offsets) -> Scatterers:
        """Build the scatterers of the object.

        Parameters
        ----------
        source : Path
            File of the scenario.
        base_station_m : ndarray of float64, shape (3,)

        Returns
        -------
        Scatterers
        """
        sizes = self.model_dump(exclude={"kind", *_ObjectTable.model_fields})
        offsets = self.outline(**sizes)
        amplitude = np.full(len(offsets), self.amplitude)
        own = self._own_velocities(len(offsets))
        if self.yaw_deg:
            offsets, own = turned(offsets, self.yaw_deg), turned(own, self.yaw_deg)
        xyz = np.array(self.position_m) + offsets
        if not isinstance(self.velocity_mps, tuple):
            return Scatterers(xyz, np.full(len(xyz), self.velocity_mps), amplitude)
        velocities = body_velocities(offsets, self.velocity_mps, self.yaw_rate_dps, own)
        xyz = xyz.round(DECIMALS) + 0.0
        speeds = approach_speeds(xyz, velocities, base_station_m)
        return Scatterers(xyz, speeds.round(DECIMALS) + 0.0, amplitude)

    def _own_velocities(self, n: int) -> Offsets:
        """Velocities (n, 3) of limbs and wheels relative to the body, before it is turned."""
        return np.zeros((n, 3))

    @property
    def _forward_mps(self) -> float:
        """Speed along the object's heading."""
        is_vector = isinstance(self.velocity_mps, tuple)
        return float(np.dot(self.velocity_mps, heading(self.yaw_deg))) if is_vector else 0.0


class CarTable(_ObjectTable):
    """Car as the paper outlines it."""

    kind: Literal["car"]
    size_m: Size = (2.0, 6.0, 1.8)
    outline = staticmethod(car)


class VehicleTable(_ObjectTable):
    """Vehicle with sampled surfaces and wheels that roll."""

    kind: Literal["vehicle"]
    size_m: Size = (1.8, 4.5, 1.5)
    spacing_m: Positive = 0.5
    outline = staticmethod(vehicle)

    def _own_velocities(self, n: int) -> Offsets:
        """Velocities (n, 3) of the rims, which come last."""
        own = np.zeros((n, 3))
        own[-4 * len(RIM) :] = self._forward_mps * wheel_roll()
        return own


class PedestrianTable(_ObjectTable):
    """Walking person, whose limbs swing where the velocity is a vector."""

    kind: Literal["pedestrian"]
    height_m: Positive = 1.8
    stride_phase_deg: Finite = 0.0
    outline = staticmethod(pedestrian)

    def _own_velocities(self, n: int) -> Offsets:
        """Velocities (n, 3) of the limbs."""
        return self._forward_mps * limb_swing(self.stride_phase_deg)


class LampPostTable(_ObjectTable):
    """Mast with four arms."""

    kind: Literal["lamp_post"]
    height_m: Positive = 10.0
    foot_m: NonNegative = 2.0
    spacing_m: Positive = 1.0
    arm_m: Positive = 1.0
    outline = staticmethod(lamp_post)


class GreenBeltTable(_ObjectTable):
    """Hedge outlined by its long edges."""

    kind: Literal["green_belt"]
    size_m: Size = (1.0, 20.0, 1.0)
    spacing_m: Positive = 0.5
    outline = staticmethod(green_belt)


class BoxTable(_ObjectTable):
    """Box with sampled sides and top."""

    kind: Literal["box"]
    size_m: Size = (1.0, 6.0, 1.0)
    spacing_m: Positive = 0.5
    outline = staticmethod(box)


class WallTable(_ObjectTable):
    """Upright wall."""

    kind: Literal["wall"]
    size_m: tuple[Positive, Positive] = (12.0, 6.0)
    spacing_m: Positive = 0.5
    outline = staticmethod(wall)


class PoleTable(_ObjectTable):
    """Upright pole."""

    kind: Literal["pole"]
    height_m: Positive = 6.0
    spacing_m: Positive = 0.5
    outline = staticmethod(pole)


class RailTable(_ObjectTable):
    """Guard rail."""

    kind: Literal["rail"]
    length_m: Positive = 8.0
    spacing_m: Positive = 0.5
    outline = staticmethod(rail)


class PointTable(_ObjectTable):
    """Lone scatterer."""

    kind: Literal["point"]
    outline = staticmethod(lambda: np.zeros((1, 3)))


class PointsTable(FileTable):
    """Points of a csv; position and velocity shift them all, the amplitude scales them all."""

    kind: Literal["points"]
    file: str
    position_m: Position = (0.0, 0.0, 0.0)
    velocity_mps: Finite = 0.0
    amplitude: Positive = 1.0

    def scatterers(self, source: Path, base_station_m: Offsets) -> Scatterers:
        """Read the scatterers of the csv, which lies in the folder of the scenario's file.

        Parameters
        ----------
        source : Path
            File of the scenario.
        base_station_m : ndarray of float64, shape (3,)

        Returns
        -------
        Scatterers
        """
        path = source.parent / self.file
        # Where the scenario is a symbolic link, its files may lie in the folder of its target.
        require_inside(path, source.parent, source.resolve().parent)
        xyz, velocity, amplitude = read_points_csv(path)
        return Scatterers(
            np.array(self.position_m) + xyz, self.velocity_mps + velocity, self.amplitude * amplitude
        )


AnyObject = Annotated[
    CarTable
    | VehicleTable
    | PedestrianTable
    | LampPostTable
    | GreenBeltTable
    | BoxTable
    | WallTable
    | PoleTable
    | RailTable
    | PointTable
    | PointsTable,
    Field(discriminator="kind"),
]
"""Entry of ``[[objects]]``."""
