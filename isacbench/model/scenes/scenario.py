"""Scenario files: TOML in, a validated `Scenario` out."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StrictBool

from isacbench.errors import InputError
from isacbench.files.checked_files import require_inside
from isacbench.files.toml_files import builtin_names, find_toml, read_toml
from isacbench.model.array import VirtualArray
from isacbench.model.cloud_files.point_files import read_points_csv
from isacbench.model.frame import FrameName, get_frame
from isacbench.model.numerology import System
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers, Scenario
from isacbench.model.scenes.objects import car, green_belt, lamp_post, pedestrian

if TYPE_CHECKING:
    from pathlib import Path


def scenario_names() -> list[str]:
    """Names of the built-in scenarios."""
    return builtin_names()


def load_scenario(name_or_path: str | Path) -> Scenario:
    """Load a built-in scenario by name, or any by the path of its TOML file.

    Parameters
    ----------
    name_or_path : str or Path
        A name that `scenario_names` lists, or a path that ends in ``.toml``.

    Returns
    -------
    Scenario

    Raises
    ------
    InputError
        Naming file, key, value and what is allowed.

    Examples
    --------
    >>> load_scenario("street").array.shape
    (16, 16)
    """
    path = find_toml(name_or_path, "scenario")
    table = read_toml(path, _ScenarioTable)
    try:
        return table.scenario(path)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _ascending(limits: tuple[float, float]) -> tuple[float, float]:
    if limits[0] > limits[1]:
        raise ValueError("must ascend, lower limit first")
    return limits


MAX_NAME = 200
"""Characters of a name: it stands in every row and above every picture."""

# Strict, because a number in quotes or a `true` for a number is a typing error.
Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[Finite, Field(gt=0)]
NonNegative = Annotated[Finite, Field(ge=0)]
Ratio = Annotated[Finite, Field(ge=0, le=1)]
Count = Annotated[int, Field(strict=True, ge=1)]
Position = tuple[Finite, Finite, Finite]
Size = tuple[Positive, Positive, Positive]
Limits = Annotated[tuple[Finite, Finite], AfterValidator(_ascending)]
Offsets = NDArray[np.float64]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _SystemTable(_Table):
    carrier_hz: Positive = System.carrier_hz
    subcarrier_spacing_hz: Positive = System.subcarrier_spacing_hz
    n_subcarriers: Count = System.n_subcarriers
    n_symbols: Count = System.n_symbols
    cyclic_prefix_ratio: Ratio = System.cyclic_prefix_ratio
    cyclic_suffix_ratio: Ratio = System.cyclic_suffix_ratio
    coherent_phase: StrictBool = System.coherent_phase


class _ArrayTable(_Table):
    frame: FrameName
    yaw_deg: Finite = 0.0
    tilt_deg: Finite = 0.0
    tx_shape: tuple[Count, Count] = VirtualArray.tx_shape
    rx_shape: tuple[Count, Count] = VirtualArray.rx_shape
    tx_spacing: Count = VirtualArray.tx_spacing
    rx_spacing: Count = VirtualArray.rx_spacing


class _BaseStationTable(_Table):
    position_m: Position


class _RegionTable(_Table):
    x_m: Limits
    y_m: Limits
    z_m: Limits
    speed_mps: Limits


class _ScoringTable(_Table):
    radius_m: Positive = Scenario.radius_m


class _ObjectTable(_Table):
    position_m: Position
    velocity_mps: Finite = 0.0
    amplitude: Positive = 1.0

    def scatterers(self, source: Path) -> Scatterers:
        """Scatterers of the object; `source` is the scenario's file, whose folder holds its own."""
        sizes = self.model_dump(exclude={"kind", *_ObjectTable.model_fields})
        xyz = np.array(self.position_m) + self.outline(**sizes)
        return Scatterers(xyz, np.full(len(xyz), self.velocity_mps), np.full(len(xyz), self.amplitude))

    outline: ClassVar[Callable[..., Offsets]]
    """Gives scatterer positions (n, 3) around `position_m` from the keys of the kind."""


class _CarTable(_ObjectTable):
    kind: Literal["car"]
    size_m: Size = (2.0, 6.0, 1.8)
    outline = staticmethod(car)


class _PedestrianTable(_ObjectTable):
    kind: Literal["pedestrian"]
    height_m: Positive = 1.8
    outline = staticmethod(pedestrian)


class _LampPostTable(_ObjectTable):
    kind: Literal["lamp_post"]
    height_m: Positive = 10.0
    foot_m: NonNegative = 2.0
    spacing_m: Positive = 1.0
    arm_m: Positive = 1.0
    outline = staticmethod(lamp_post)


class _GreenBeltTable(_ObjectTable):
    kind: Literal["green_belt"]
    size_m: Size = (1.0, 20.0, 1.0)
    spacing_m: Positive = 0.5
    outline = staticmethod(green_belt)


class _PointsTable(_Table):
    """Points of a csv; position and velocity shift them all, the amplitude scales them all."""

    kind: Literal["points"]
    file: str
    position_m: Position = (0.0, 0.0, 0.0)
    velocity_mps: Finite = 0.0
    amplitude: Positive = 1.0

    def scatterers(self, source: Path) -> Scatterers:
        path = source.parent / self.file
        # Where the scenario is a symbolic link, its files may lie in the folder of its target.
        require_inside(path, source.parent, source.resolve().parent)
        xyz, velocity, amplitude = read_points_csv(path)
        return Scatterers(
            np.array(self.position_m) + xyz, self.velocity_mps + velocity, self.amplitude * amplitude
        )


class _ScenarioTable(_Table):
    name: Annotated[str, Field(min_length=1, max_length=MAX_NAME)]
    system: _SystemTable = _SystemTable()
    array: _ArrayTable
    base_station: _BaseStationTable
    region: _RegionTable
    scoring: _ScoringTable = _ScoringTable()
    objects: tuple[
        Annotated[
            _CarTable | _PedestrianTable | _LampPostTable | _GreenBeltTable | _PointsTable,
            Field(discriminator="kind"),
        ],
        ...,
    ] = ()

    def scenario(self, source: Path) -> Scenario:
        """Build the scenario; `source` is its file."""
        parts = [entry.scatterers(source) for entry in self.objects]
        scatterers = Scatterers(
            np.concatenate([np.empty((0, 3)), *(part.xyz for part in parts)]),
            np.concatenate([np.empty(0), *(part.velocity for part in parts)]),
            np.concatenate([np.empty(0), *(part.amplitude for part in parts)]),
        )
        return Scenario(
            name=self.name,
            system=System(**self.system.model_dump()),
            array=VirtualArray(**self.array.model_dump(exclude={"frame", "yaw_deg", "tilt_deg"})),
            frame=get_frame(self.array.frame, self.array.yaw_deg, self.array.tilt_deg),
            base_station_m=np.array(self.base_station.position_m),
            region=Region(**self.region.model_dump()),
            scatterers=scatterers,
            radius_m=self.scoring.radius_m,
        )
