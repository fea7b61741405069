"""Objects of a scenario file: their keys, and the scatterers that they stand for."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from isacbench.checked_arrays import Floats
from isacbench.errors import InputError
from isacbench.files.checked_files import require_inside
from isacbench.model.cloud_files.point_files import read_points_csv
from isacbench.model.number_limits import LARGEST_PLACE_M
from isacbench.model.scene import Scatterers
from isacbench.model.scenes import objects
from isacbench.model.scenes.placed_objects import CROSS_SECTIONS, PlacedObject, Surroundings
from isacbench.model.scenes.solids import Part, globe, solid_of, tube
from isacbench.model.surfaces.mesh_files import box_of, read_mesh
from isacbench.model.surfaces.surface_points import clipped, surface_points

# Strict, because a number in quotes or a `true` for a number is a typing error.
Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[Finite, Field(gt=0)]
Length = Annotated[Positive, Field(le=LARGEST_PLACE_M)]
NonNegative = Annotated[Finite, Field(ge=0)]
Position = tuple[Finite, Finite, Finite]
Size = tuple[Positive, Positive, Positive]


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


MOST_DBSM = 200.0


def _number_or_name(value: Any) -> float | str:
    """Take a cross section in dBsm, or a name of 3GPP TR 38.901."""
    if isinstance(value, str) and value in CROSS_SECTIONS:
        return value
    if type(value) in (int, float) and abs(value) <= MOST_DBSM:
        return float(value)
    names = ", ".join(f'"{name}"' for name in CROSS_SECTIONS)
    raise ValueError(f"allowed is a number of dBsm from {-MOST_DBSM:g} to {MOST_DBSM:g}, or one of {names}")


CrossSection = Annotated[Any, AfterValidator(_number_or_name)]


Role = Literal["target", "clutter"]


class _EchoTable(FileTable):
    @model_validator(mode="after")
    def _require_one_strength(self) -> Self:
        if {"amplitude", "rcs_dbsm"} <= self.model_fields_set:
            raise ValueError("allowed is amplitude or rcs_dbsm, not both")
        return self


class _ObjectTable(_EchoTable):
    position_m: Position
    velocity_mps: Velocity = 0.0
    amplitude: Positive = 1.0
    rcs_dbsm: CrossSection = None
    yaw_deg: Finite = 0.0
    yaw_rate_dps: Finite = 0.0
    role: Role = "target"

    outline: ClassVar[Callable[..., Floats]]
    """Gives scatterer positions (n, 3) around `position_m` from the keys of the kind."""

    @model_validator(mode="after")
    def _require_vector(self) -> Self:
        if self.yaw_rate_dps and not isinstance(self.velocity_mps, tuple):
            raise ValueError("yaw_rate_dps needs velocity_mps as a vector [x, y, z]")
        return self

    def placed(self, around: Surroundings) -> PlacedObject:
        """Build the scatterers of the object, and its surfaces if they are needed."""
        offsets, parts = self._shape(around)
        scatterers = self._scatterers(offsets, around.base_station_m)
        return PlacedObject(scatterers, [(self._in_place(part), own) for part, own in parts], self.rcs_dbsm)

    def _shape(self, around: Surroundings) -> tuple[Floats, list[Part]]:
        """Scatterer positions around `position_m`, and parts that hide others."""
        sizes = self.model_dump(exclude=set(_ObjectTable.model_fields))
        kind = sizes.pop("kind")
        return self.outline(**sizes), solid_of(kind, sizes) if around.with_solids else []

    def _turned(self, vectors: Floats) -> Floats:
        """Turn vectors (..., 3) from the object's own directions to those of the scene."""
        if not self.yaw_deg:
            return vectors
        return objects.turned(vectors.reshape(-1, 3), self.yaw_deg).reshape(vectors.shape)

    def _in_place(self, vectors: Floats) -> Floats:
        """Turn and shift what lies around `position_m`."""
        return np.array(self.position_m) + self._turned(vectors)

    def _scatterers(self, offsets: Floats, base_station_m: Floats) -> Scatterers:
        amplitude = np.full(len(offsets), self.amplitude)
        own = self._turned(self._own_velocities(len(offsets)))
        xyz = self._in_place(offsets)
        if not isinstance(self.velocity_mps, tuple):
            return Scatterers(xyz, np.full(len(xyz), self.velocity_mps), amplitude)
        velocities = objects.body_velocities(self._turned(offsets), self.velocity_mps, self.yaw_rate_dps, own)
        xyz = xyz.round(objects.DECIMALS) + 0.0
        speeds = objects.approach_speeds(xyz, velocities, base_station_m)
        return Scatterers(xyz, speeds.round(objects.DECIMALS) + 0.0, amplitude)

    def _own_velocities(self, n: int) -> Floats:
        """Velocities (n, 3) of limbs and wheels relative to the body, before it is turned."""
        return np.zeros((n, 3))

    @property
    def _forward_mps(self) -> float:
        """Speed along the object's heading."""
        is_vector = isinstance(self.velocity_mps, tuple)
        return float(np.dot(self.velocity_mps, objects.heading(self.yaw_deg))) if is_vector else 0.0


class CarTable(_ObjectTable):
    """Car as the paper outlines it."""

    kind: Literal["car"]
    size_m: Size = (2.0, 6.0, 1.8)
    outline = staticmethod(objects.car)


class _SampledTable(_ObjectTable):
    spacing_m: Positive = 0.5


class _WheeledTable(_SampledTable):
    n_wheels: ClassVar[int]

    def _own_velocities(self, n: int) -> Floats:
        """Velocities (n, 3) of the rims, which come last."""
        roll = self._forward_mps * objects.wheel_roll(self.n_wheels)
        return np.concatenate([np.zeros((n - len(roll), 3)), roll])


class VehicleTable(_WheeledTable):
    """Vehicle with sampled surfaces and wheels that roll."""

    kind: Literal["vehicle"]
    size_m: Size = (1.8, 4.5, 1.5)
    outline = staticmethod(objects.vehicle)
    n_wheels = 4


class LorryTable(_WheeledTable):
    """Lorry: cab, cargo box, and six wheels that roll."""

    kind: Literal["lorry"]
    size_m: Size = (2.5, 9.0, 3.6)
    outline = staticmethod(objects.lorry)
    n_wheels = 6


class CyclistTable(_ObjectTable):
    """Cyclist, whose wheels and legs turn where the velocity is a vector."""

    kind: Literal["cyclist"]
    crank_phase_deg: Finite = 0.0
    outline = staticmethod(objects.cyclist)

    def _own_velocities(self, n: int) -> Floats:
        """Velocities (n, 3) of wheels and legs."""
        return self._forward_mps * objects.pedalling(self.crank_phase_deg)


class PedestrianTable(_ObjectTable):
    """Walking person, whose limbs swing where the velocity is a vector."""

    kind: Literal["pedestrian"]
    height_m: Positive = 1.8
    stride_phase_deg: Finite = 0.0
    outline = staticmethod(objects.pedestrian)

    def _own_velocities(self, n: int) -> Floats:
        """Velocities (n, 3) of the limbs."""
        return self._forward_mps * objects.limb_swing(self.stride_phase_deg)


class LampPostTable(_ObjectTable):
    """Mast with four arms."""

    kind: Literal["lamp_post"]
    height_m: Positive = 10.0
    foot_m: NonNegative = 2.0
    spacing_m: Positive = 1.0
    arm_m: Positive = 1.0
    outline = staticmethod(objects.lamp_post)


class GreenBeltTable(_SampledTable):
    """Hedge outlined by its long edges."""

    kind: Literal["green_belt"]
    size_m: Size = (1.0, 20.0, 1.0)
    outline = staticmethod(objects.green_belt)


class BoxTable(_SampledTable):
    """Box with sampled sides and top."""

    kind: Literal["box"]
    size_m: Size = (1.0, 6.0, 1.0)
    outline = staticmethod(objects.box)


class WallTable(_SampledTable):
    """Upright wall."""

    kind: Literal["wall"]
    size_m: tuple[Positive, Positive] = (12.0, 6.0)
    outline = staticmethod(objects.wall)


class PoleTable(_SampledTable):
    """Upright pole."""

    kind: Literal["pole"]
    height_m: Positive = 6.0
    outline = staticmethod(objects.pole)


class RailTable(_SampledTable):
    """Guard rail."""

    kind: Literal["rail"]
    length_m: Positive = 8.0
    outline = staticmethod(objects.rail)


class PointTable(_ObjectTable):
    """Lone scatterer."""

    kind: Literal["point"]
    outline = staticmethod(lambda: np.zeros((1, 3)))


class _SurfaceTable(_SampledTable):
    """Closed surface, sampled all around."""

    @abstractmethod
    def _triangles(self, around: Surroundings) -> Floats:
        """Triangles (n, 3, 3) around `position_m`, in the object's own directions."""

    def _shape(self, around: Surroundings) -> tuple[Floats, list[Part]]:
        triangles = self._triangles(around)
        return surface_points(triangles, self.spacing_m), [(triangles, ())]


class CylinderTable(_SurfaceTable):
    """Upright cylinder."""

    kind: Literal["cylinder"]
    radius_m: Length = 0.5
    height_m: Length = 1.0

    def _triangles(self, around: Surroundings) -> Floats:
        return tube(np.zeros(3), [0.0, 0.0, self.height_m], self.radius_m)


class EllipsoidTable(_SurfaceTable):
    """Ellipsoid that stands on the ground."""

    kind: Literal["ellipsoid"]
    size_m: tuple[Length, Length, Length] = (1.0, 1.0, 1.0)

    def _triangles(self, around: Surroundings) -> Floats:
        return globe([0.0, 0.0, self.size_m[2] / 2], np.array(self.size_m) / 2)


PLACED_M = 1e-9
"""Distance up to which a point outside the region counts as in it: the rounding of a turn."""


class MeshTable(_SurfaceTable):
    """Mesh or city from a file, sampled within the region."""

    kind: Literal["mesh"]
    file: str
    position_m: Position = (0.0, 0.0, 0.0)
    scale: Positive | None = None
    up: Literal["y", "z"] | None = None

    def _triangles(self, around: Surroundings) -> Floats:
        path = _file_of(around.source, self.file)
        return read_mesh(path, self.scale, self.up, float(np.linalg.norm(around.region.size_m)))

    def _shape(self, around: Surroundings) -> tuple[Floats, list[Part]]:
        triangles = self._triangles(around)
        placed = self._in_place(triangles)
        within = clipped(placed, around.region.lower_m, around.region.upper_m)
        if within is placed:
            own = triangles
        else:
            own = objects.turned((within - self.position_m).reshape(-1, 3), -self.yaw_deg).reshape(-1, 3, 3)
        points = surface_points(own, self.spacing_m)
        points = points[around.region.contains(self._in_place(points).round(objects.DECIMALS), PLACED_M)]
        if not len(points):
            raise InputError(
                f"{self.file}: no part of its surface lies in the region, {around.region}; its bounding box "
                f"is {box_of(placed)}; allowed are triangles with an area that reach into the region, and a "
                "scale if the file is not in metres"
            )
        return points, [(triangles, ())]


def _file_of(source: Path, name: str) -> Path:
    """File that a scenario names, in the folder of the scenario's file or below it."""
    path = source.parent / name
    # Where the scenario is a symbolic link, its files may lie in the folder of its target.
    require_inside(path, source.parent, source.resolve().parent)
    return path


class PointsTable(_EchoTable):
    """Points of a csv; position and velocity shift them all, the amplitude scales them all."""

    kind: Literal["points"]
    file: str
    position_m: Position = (0.0, 0.0, 0.0)
    velocity_mps: Finite = 0.0
    amplitude: Positive = 1.0
    rcs_dbsm: CrossSection = None
    role: Role = "target"

    def placed(self, around: Surroundings) -> PlacedObject:
        """Read the scatterers of the csv, which lies in the folder of the scenario's file."""
        points = read_points_csv(_file_of(around.source, self.file))
        scatterers = Scatterers(
            np.array(self.position_m) + points.xyz,
            self.velocity_mps + points.velocity,
            self.amplitude * points.amplitude,
            objects=points.objects,
        )
        return PlacedObject(scatterers, rcs_dbsm=self.rcs_dbsm)


MovingObject = CarTable | VehicleTable | LorryTable | CyclistTable | PedestrianTable
StandingObject = LampPostTable | GreenBeltTable | BoxTable | WallTable | PoleTable | RailTable
Surface = CylinderTable | EllipsoidTable | MeshTable
AnyObject = Annotated[
    MovingObject | StandingObject | Surface | PointTable | PointsTable, Field(discriminator="kind")
]
"""Entry of ``[[objects]]``."""
