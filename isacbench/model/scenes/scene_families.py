"""Families of generated scenes: their parameters, and how a scene of one is spelled."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from isacbench.choices import Mimo
from isacbench.errors import InputError, did_you_mean
from isacbench.files.escaping import quoted, shortened
from isacbench.files.toml_files import builtin_names, find_toml
from isacbench.specifications import MAX_VARIANTS, Spec, spec_variants, spell_spec

MOST_SEED = 2**53
Seed = Annotated[int, Field(strict=True, ge=0, le=MOST_SEED)]
Count = Annotated[int, Field(strict=True, ge=0, le=1000)]


class FamilyParameters(BaseModel):
    """Parameters of every family.

    Attributes
    ----------
    seed : int
        Seed of the objects. Those below 500 are for developing estimators,
        500 to 999 for validating, 1000 and up for reporting.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    seed: Seed


class StreetParameters(FamilyParameters):
    """Parameters of families of scenes before the paper's radio.

    Attributes
    ----------
    frame : {"panel", "paper"}
        Frame of the array.
    coherent_phase : bool
        True if every echo has the carrier's phase, false if all are in phase.
    gain_error_db, phase_error_deg : float
        Standard deviations of the gain and phase errors of the virtual elements.
    mimo : {"ideal", "comb", "tdm"}
        How the transmitters are separated.
    leakage_db : float or None
        Power of the direct path from the transmitters over that of all echoes.
    visible : {"all", "seen"}
        Scatterers of transparent objects, or those that the base station sees past all surfaces.
    """

    frame: Literal["panel", "paper"] = "panel"
    coherent_phase: Annotated[bool, Field(strict=True)] = False
    gain_error_db: Annotated[float, Field(strict=True, ge=0, le=10, allow_inf_nan=False)] = 0.0
    phase_error_deg: Annotated[float, Field(strict=True, ge=0, le=180, allow_inf_nan=False)] = 0.0
    mimo: Mimo = "ideal"
    leakage_db: Annotated[
        Annotated[float, Field(strict=True, ge=-200, le=200)] | None,
        BeforeValidator(lambda value: None if value == "none" else value),
    ] = None
    visible: Literal["all", "seen"] = "all"


class DensityParameters(StreetParameters):
    """Parameters of a family of mixed objects.

    Attributes
    ----------
    density : {"low", "medium", "high"}
        Number of objects.
    """

    density: Literal["low", "medium", "high"] = "medium"


class WeakParameters(DensityParameters):
    """Parameters of the family ``weak``.

    Attributes
    ----------
    dynamic_range_db : float
        Range of the powers of objects.
    """

    dynamic_range_db: Annotated[float, Field(strict=True, ge=0, le=60, allow_inf_nan=False)] = 40.0


class CrowdParameters(StreetParameters):
    """Parameters of the family ``crowd``.

    Attributes
    ----------
    pedestrians : int
        Number of pedestrians; 0 draws 8 to 16.
    """

    pedestrians: Count = 0


class TrafficParameters(StreetParameters):
    """Parameters of the families ``traffic`` and ``crossing``, whose objects hide each other by default."""

    visible: Literal["all", "seen"] = "seen"


class SparseParameters(StreetParameters):
    """Parameters of the family ``sparse``.

    Attributes
    ----------
    scatterers : int
        Number of lone scatterers; 0 draws 1 to 20.
    """

    scatterers: Annotated[Count, Field(le=200)] = 0


class UmaAvParameters(FamilyParameters):
    """Parameters of the family ``uma-av``.

    Attributes
    ----------
    targets : int
        Number of drones.
    tx_power_dbm : float
        Transmit power of the link budget.
    path_loss : {"uma_av", "free_space"}
        Path loss, with line of sight and shadow fading drawn, or that of free space.
    clutter : {"none", "ground"}
        Nothing else, or cars and people who move on the ground and are no targets.
    """

    targets: Annotated[Count, Field(le=50)] = 5
    tx_power_dbm: Annotated[float, Field(strict=True, ge=-50, le=80, allow_inf_nan=False)] = 52.0
    path_loss: Literal["uma_av", "free_space"] = "uma_av"
    clutter: Literal["none", "ground"] = "none"


@dataclass(frozen=True)
class Family:
    """Family of generated scenes; its version counts up when a seed gives other scenes than before."""

    name: str
    version: int
    description: str
    parameters: type[FamilyParameters] = StreetParameters


FAMILIES = {
    family.name: family
    for family in (
        Family("street", 1, "the paper's objects elsewhere, mirrored and turned"),
        Family("town", 1, "vehicles, pedestrians, posts, rails and hedges", DensityParameters),
        Family("facade", 1, "house fronts with movers before them", DensityParameters),
        Family(
            "crowd", 1, "pedestrians whose limbs swing; 8 to 16 unless their number is given", CrowdParameters
        ),
        Family("weak", 1, "a town whose objects differ by up to 40 dB in echo, or as given", WeakParameters),
        Family(
            "sparse",
            1,
            "lone scatterers a Rayleigh cell apart; 1 to 20 unless their number is given",
            SparseParameters,
        ),
        Family(
            "traffic",
            1,
            "cars with turning wheels, cyclists, and lorries that hide others, on a road",
            TrafficParameters,
        ),
        Family(
            "crossing", 1, "vehicles, cyclists and pedestrians that move in all directions", TrafficParameters
        ),
        Family("uma-av", 1, "drones over a sector of an urban macro cell; link budget", UmaAvParameters),
    )
}


@dataclass(frozen=True)
class FamilySpec:
    """A scene of a family."""

    family: Family
    parameters: FamilyParameters

    @property
    def name(self) -> str:
        """Canonical spelling: the seed, then the parameters that differ from their defaults."""
        fields = type(self.parameters).model_fields
        values = self.parameters.model_dump()
        changed = {key: value for key, value in values.items() if value != fields[key].default}
        return spell_spec(self.family.name, changed)


USES = {0: "developing", 500: "validating", 1000: "reporting"}
"""First seeds by what they are for."""


def use_of_seed(seed: int) -> str:
    """Tell what the scenes of a seed are for; nothing for a negative number, which is no seed."""
    return next((use for first, use in reversed(USES.items()) if seed >= first), "")


def is_family_spec(name_or_path: str | Path) -> bool:
    """Tell whether a scenario is spelled as one of a family: with brackets, and not as a TOML file."""
    return "[" in str(name_or_path) and Path(name_or_path).suffix != ".toml"


def scenario_file(name_or_path: str | Path) -> Path:
    """Find the file of a scenario by a built-in name or by path; refuse the name of a family."""
    name = str(name_or_path)
    if name in FAMILIES and name not in builtin_names():
        raise InputError(f"scenario {name!r} is a family of scenes; give a seed, such as {name}[seed=7]")
    return find_toml(name_or_path, "scenario", others="a generated scene such as town[seed=7], ")


def scenario_variants(name_or_path: str) -> list[str]:
    """List the scenarios that a name stands for: several where it is a family with a range of seeds.

    The seed may be a range ``0:99`` with both ends, and any value a list ``[a,b]``. A file must
    be there.
    """
    if not is_family_spec(name_or_path):
        scenario_file(name_or_path)
    return spelled_scenarios([name_or_path])


def spelled_scenarios(listed: Iterable[str]) -> list[str]:
    """Spell every scenario of a list by itself; files need not be there."""
    return [text for entry in listed for text in _spelled(entry)]


@lru_cache(maxsize=64)
def _spelled(entry: str) -> tuple[str, ...]:
    return tuple(spec.name for spec in family_specs(entry)) if is_family_spec(entry) else (entry,)


def family_specs(text: str) -> list[FamilySpec]:
    """Parse ``family[seed=0:99,param=value,...]``, which may stand for several scenes, each named once."""
    found: dict[str, FamilySpec] = {}
    for variant in spec_variants(text):
        for spec in _seeded(variant.spec, text):
            if spec.name in found:
                raise InputError(f"scenario {quoted(text)} names {spec.name} twice")
            found[spec.name] = spec
            if len(found) > MAX_VARIANTS:
                raise InputError(f"scenario {quoted(text)}: allowed are at most {MAX_VARIANTS} scenes")
    return list(found.values())


def _seeded(spec: Spec, text: str) -> Iterator[FamilySpec]:
    """Scenes of a specification, one for each seed of its range."""
    family = FAMILIES.get(spec.name)
    if family is None:
        raise InputError(
            f"scenario {quoted(text)}: unknown family {spec.name!r}; {did_you_mean(spec.name, FAMILIES)}"
        )
    known = family.parameters.model_fields
    for key in spec.params:
        if key not in known:
            raise InputError(
                f"scenario {quoted(text)}: {family.name} has no parameter {key!r}; {did_you_mean(key, known)}"
            )
    if "seed" not in spec.params:
        raise InputError(f"scenario {quoted(text)}: a family needs a seed, such as {spec.name}[seed=7]")
    for seed in _seeds(spec.params["seed"], text):
        yield FamilySpec(family, _parameters(family, {**spec.params, "seed": seed}, text))


def _seeds(value: Any, text: str) -> range | list[Any]:
    """Seeds of a range ``first:last``, or the one that is given."""
    if not isinstance(value, str) or ":" not in value:
        return [value]
    ends = value.split(":")
    if len(ends) != 2 or not all(map(_is_seed, ends)) or int(ends[0]) > int(ends[1]):
        raise InputError(
            f"scenario {quoted(text)}: seed={shortened(value)}: allowed is a range first:last such as 0:99, "
            "the first not above the last"
        )
    return range(int(ends[0]), int(ends[1]) + 1)


def _is_seed(text: str) -> bool:
    """Tell whether a text has the digits of a seed, and no more than Python converts."""
    return text.isascii() and text.isdecimal() and len(text) <= len(str(MOST_SEED))


def _parameters(family: Family, values: dict[str, Any], text: str) -> FamilyParameters:
    """Check the values of a family's parameters."""
    try:
        return family.parameters.model_validate(values)
    except ValidationError as error:
        mistake = error.errors(include_url=False)[0]
        name, message = mistake["loc"][0], mistake["msg"]
        value = quoted(mistake["input"])
        raise InputError(
            f"scenario {quoted(text)}: {name} = {value}: {message[0].lower()}{message[1:]}"
        ) from error
