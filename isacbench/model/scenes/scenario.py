"""Scenarios from TOML files and from families: tables in, a validated `Scenario` out."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, StrictBool, StrictInt

from isacbench.choices import Mimo, NoiseSource
from isacbench.errors import InputError
from isacbench.files.toml_files import read_toml
from isacbench.model.array import MOST_LEAKAGE_DB, VirtualArray
from isacbench.model.frame import HALF_WAVELENGTHS, FrameName, get_frame
from isacbench.model.link_budget import ElementPattern, LinkBudget, PathLoss
from isacbench.model.numerology import Prs, System
from isacbench.model.region import Region
from isacbench.model.scene import CLUTTER, ERRORS, MOST_ERRORS, Scenario, no_input_warnings
from isacbench.model.scenes.generators import scene_table
from isacbench.model.scenes.object_tables import AnyObject, FileTable, Finite, Position, Positive
from isacbench.model.scenes.placed_objects import (
    PlacedObject,
    Surroundings,
    join_scatterers,
    seen_objects,
    with_budget,
    with_cross_section,
    with_path_loss,
)
from isacbench.model.scenes.scene_families import (
    FamilySpec,
    Seed,
    family_specs,
    is_family_spec,
    scenario_file,
)


def load_scenario(name_or_path: str | Path) -> Scenario:
    """Load a built-in scenario by name, any by the path of its TOML file, or generate one of a family.

    Parameters
    ----------
    name_or_path : str or Path
        A name of a built-in scenario, a path that ends in ``.toml``, or
        a family with a seed and further parameters, ``family[seed=7,...]``.

    Returns
    -------
    Scenario
        One of a family is the same on every machine.

    Raises
    ------
    InputError
        Naming file, key, value and what is allowed.

    Examples
    --------
    >>> load_scenario("street").array.shape
    (16, 16)
    >>> load_scenario("sparse[scatterers=3,seed=7]").name
    'sparse[seed=7,scatterers=3]'
    """
    if is_family_spec(name_or_path):
        specs = family_specs(str(name_or_path))
        if len(specs) > 1:
            raise InputError(
                f"scenario {str(name_or_path)!r} names {len(specs)} scenes; give one value for each parameter"
            )
        return _generated(specs[0])
    path = scenario_file(name_or_path)
    table = read_toml(path, _ScenarioTable)
    try:
        return table.scenario(path)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _generated(spec: FamilySpec) -> Scenario:
    """Scenario of a family."""
    table = _ScenarioTable.model_validate(scene_table(spec))
    with no_input_warnings():  # families keep to their region; docs/scenarios.md says what else they do
        return dataclasses.replace(
            table.scenario(Path()), family=spec.family.name, family_version=spec.family.version
        )


def _ascending(limits: tuple[float, float]) -> tuple[float, float]:
    if limits[0] > limits[1]:
        raise ValueError("must ascend, lower limit first")
    return limits


MAX_NAME = 200
"""Characters of a name: it stands in every row and above every picture."""

Ratio = Annotated[Finite, Field(ge=0, le=1)]
Count = Annotated[int, Field(strict=True, ge=1)]
GainError = Annotated[Finite, Field(ge=0, le=MOST_ERRORS[0])]
PhaseError = Annotated[Finite, Field(ge=0, le=MOST_ERRORS[1])]
Leakage = Annotated[Finite, Field(ge=-MOST_LEAKAGE_DB, le=MOST_LEAKAGE_DB)]
Limits = Annotated[tuple[Finite, Finite], AfterValidator(_ascending)]


class _SystemTable(FileTable):
    carrier_hz: Positive = System.carrier_hz
    subcarrier_spacing_hz: Positive = System.subcarrier_spacing_hz
    n_subcarriers: Count = System.n_subcarriers
    n_symbols: Count = System.n_symbols
    cyclic_prefix_ratio: Ratio = System.cyclic_prefix_ratio
    cyclic_suffix_ratio: Ratio = System.cyclic_suffix_ratio
    coherent_phase: StrictBool = System.coherent_phase
    noise: NoiseSource = System.noise


class _PrsTable(FileTable):
    comb: StrictInt = Prs.comb
    n_symbols: StrictInt = Prs.n_symbols
    first_symbol: StrictInt = Prs.first_symbol
    period: StrictInt = Prs.period
    offset: StrictInt = Prs.offset


class _ArrayTable(FileTable):
    frame: FrameName
    yaw_deg: Finite = 0.0
    tilt_deg: Finite = 0.0
    spacing_wavelengths: tuple[Finite, Finite] = HALF_WAVELENGTHS
    tx_shape: tuple[Count, Count] = VirtualArray.tx_shape
    rx_shape: tuple[Count, Count] = VirtualArray.rx_shape
    tx_spacing: Count = VirtualArray.tx_spacing
    rx_spacing: Count = VirtualArray.rx_spacing
    ascending: tuple[Literal["-u", "+u"], Literal["-w", "+w"]] = ("-u", "-w")
    mimo: Mimo = VirtualArray.mimo
    leakage_db: Leakage | None = VirtualArray.leakage_db
    gain_error_db: GainError = Scenario.gain_error_db
    phase_error_deg: PhaseError = Scenario.phase_error_deg


class _BaseStationTable(FileTable):
    position_m: Position


class _RegionTable(FileTable):
    x_m: Limits
    y_m: Limits
    z_m: Limits
    speed_mps: Limits


class _BudgetTable(FileTable):
    tx_power_dbm: Finite
    noise_figure_db: Finite = LinkBudget.noise_figure_db
    residual_dbm: Finite | None = LinkBudget.residual_dbm
    element: ElementPattern = LinkBudget.element


class _ScoringTable(FileTable):
    radius_m: Positive = Scenario.radius_m


class _ScenarioTable(FileTable):
    name: Annotated[str, Field(min_length=1, max_length=MAX_NAME)]
    system: _SystemTable = _SystemTable()
    prs: _PrsTable = _PrsTable()
    array: _ArrayTable
    base_station: _BaseStationTable
    region: _RegionTable
    scoring: _ScoringTable = _ScoringTable()
    budget: _BudgetTable | None = None
    objects: tuple[AnyObject, ...] = ()
    visible: Literal["all", "seen"] = "all"
    path_loss: PathLoss = "none"
    rcs_seed: Seed = 0

    def scenario(self, source: Path) -> Scenario:
        """Build the scenario; `source` is its file."""
        system = System(**self.system.model_dump(), prs=Prs(**self.prs.model_dump()))
        base_station_m = np.array(self.base_station.position_m)
        region = Region(**self.region.model_dump())
        around = Surroundings(source, base_station_m, region, with_solids=self.visible == "seen")
        placed = [self._placed(number, around) for number in range(len(self.objects))]
        if self.visible == "seen":
            placed = seen_objects(placed, base_station_m)
        placed = [
            with_cross_section(each, f"rcs {self.rcs_seed} {number}") for number, each in enumerate(placed)
        ]
        if self.path_loss != "none":
            placed = [
                with_path_loss(
                    each, base_station_m, system.carrier_hz, self.path_loss, f"path {self.rcs_seed} {number}"
                )
                for number, each in enumerate(placed)
            ]
        of_frame = "yaw_deg", "tilt_deg", "spacing_wavelengths"
        array = VirtualArray(**self.array.model_dump(exclude={"frame", *of_frame, *ERRORS}))
        frame = get_frame(self.array.frame, **self.array.model_dump(include={*of_frame}))
        budget = None if self.budget is None else LinkBudget(**self.budget.model_dump())
        if budget is not None:
            self._require_powers()
            unit = budget.unit_amplitude(system, array)
            placed = [with_budget(each, budget, unit, frame, base_station_m) for each in placed]
        return Scenario(
            name=self.name,
            system=system,
            array=array,
            frame=frame,
            base_station_m=base_station_m,
            region=region,
            scatterers=join_scatterers(placed),
            radius_m=self.scoring.radius_m,
            gain_error_db=self.array.gain_error_db,
            phase_error_deg=self.array.phase_error_deg,
            budget=budget,
        )

    def _require_powers(self) -> None:
        """Refuse a link budget of echoes whose powers do not follow from cross sections and path loss."""
        if self.path_loss == "none":
            raise InputError('budget: it needs a path loss; allowed is path_loss = "free_space" or "uma_av"')
        for number, one in enumerate(self.objects):
            if one.rcs_dbsm is None:
                raise InputError(f"objects[{number}]: a link budget needs its cross section, rcs_dbsm")

    def _placed(self, number: int, around: Surroundings) -> PlacedObject:
        """Place one object; errors name it."""
        try:
            placed = self.objects[number].placed(around)
            if placed.rcs_dbsm is not None and not self.system.coherent_phase:
                raise InputError(
                    "rcs_dbsm needs carrier phases, because its scatterers would add up in phase; "
                    "allowed is coherent_phase = true in [system]"
                )
        except InputError as error:
            raise InputError(f"objects[{number}]: {error}") from error
        kinds = [each.kind for each in self.objects[: number + 1]]
        name = f"{kinds[-1]} {kinds.count(kinds[-1])}"
        if self.objects[number].role == "target":
            return dataclasses.replace(placed, name=name)
        own = tuple(CLUTTER + each for each in placed.scatterers.objects)
        scatterers = dataclasses.replace(placed.scatterers, objects=own)
        return dataclasses.replace(placed, name=CLUTTER + name, scatterers=scatterers)
