"""Suites: which estimators meet which scenarios at which SNR, and how often."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, get_args

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PrivateAttr,
    ValidationError,
    ValidationInfo,
    field_validator,
)
from pydantic_core import PydanticCustomError

from isacbench.choices import Dimension, Division, MapName, Modulation, Sensing
from isacbench.errors import InputError
from isacbench.files.toml_files import builtin_names, describe_mistake, find_toml, read_toml
from isacbench.plugins.instances import Instances, spelled_estimators

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from isacbench.plugins.contracts import Estimator

FOLDER = "suites"
MAX_GRID_POINTS = 1000
"""More SNRs than any curve needs: a larger grid is a slip of the pen."""

MAX_NAME = 200
"""Characters of a name, which becomes a part of the name of a folder."""

MAX_SNR_DB = 300.0
"""Beyond it, of either sign, double precision holds the noise alone or the echo alone."""

StudyKind = Literal["imaging", "efficiency", "resolution", "detection", "link"]

Names = Annotated[tuple[str, ...], Field(min_length=1)]
SnrDb = Annotated[float, Field(ge=-MAX_SNR_DB, le=MAX_SNR_DB)]
Snrs = Annotated[tuple[SnrDb, ...], Field(min_length=1)]
Separation = Annotated[float, Field(gt=0, le=10)]
Phase = Annotated[float, Field(gt=-360, lt=360)]
Pfa = Annotated[float, Field(gt=0, lt=1)]


class Suite(BaseModel):
    """What a run consists of.

    Attributes
    ----------
    kind : {"imaging", "efficiency", "resolution", "detection", "link"}
        What is made of the scenarios and measured; the last three are
        classes of their own, with keys of their own.
    name : str
    scenarios : tuple of str
        Names of built-in scenarios, or paths that end in ``.toml``.
    estimators : tuple of str
        Estimators as ``name[param=value,...]``.
    snr_db : tuple of float or None
        SNRs in dB, per resource element and virtual element. A suite file
        may give a table ``{start, stop, step}``.
    snr_gain_db : tuple of float or None
        SNRs in dB of a unit scatterer after the gain of all resource
        elements and virtual elements, likewise, instead of `snr_db`.
    trials : int
        Noise draws for each scenario and SNR.
    seed : int
        Seed that all noise follows from.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    KINDS: ClassVar[tuple[StudyKind, ...]] = ("imaging", "efficiency")

    _instances: Instances = PrivateAttr(default_factory=Instances)

    kind: StudyKind = "imaging"
    name: Annotated[str, Field(pattern=r"^[\w.-]+$", max_length=MAX_NAME)]
    scenarios: Names
    estimators: Names
    snr_gain_db: Snrs | None = None
    snr_db: Annotated[Snrs | None, Field(validate_default=True)] = None
    trials: Annotated[int, Field(ge=1)]
    seed: Annotated[int, Field(ge=0)] = 0

    @field_validator("kind")
    @classmethod
    def _refuse_other_kinds(cls, value: StudyKind) -> StudyKind:
        """Refuse a kind that has a class of its own."""
        if value not in cls.KINDS:
            raise ValueError(f"the class {cls.__name__} takes {' or '.join(map(repr, cls.KINDS))}")
        return value

    @field_validator("snr_db", "snr_gain_db", mode="before")
    @classmethod
    def _expand_grid(cls, value: Any) -> Any:
        """Turn a table ``{start, stop, step}`` into the list it stands for."""
        if not isinstance(value, dict):
            return value
        if set(value) != {"start", "stop", "step"}:
            raise ValueError(f"a table takes start, stop and step, not {', '.join(value) or 'nothing'}")
        if not all(type(number) in (int, float) for number in value.values()):
            raise ValueError("start, stop and step must be numbers")
        return _grid(**value)

    @field_validator("scenarios", "estimators", "snr_db", "snr_gain_db")
    @classmethod
    def _refuse_repeats(cls, values: tuple[Any, ...] | None) -> tuple[Any, ...] | None:
        """Refuse a repeated entry, which would yield two rows with the same key."""
        return None if values is None else _unrepeated(values)

    @field_validator("snr_db")
    @classmethod
    def _require_one_axis(cls, value: Any, info: ValidationInfo) -> Any:
        """Refuse SNRs that are given twice or not at all; a mistake in the others is told by itself."""
        others = info.data.get("snr_gain_db", ())
        if value is None and others is None:
            raise PydanticCustomError("missing", "missing")
        if value is not None and others:
            raise ValueError("give either snr_db, per element, or snr_gain_db, after all gain")
        return value

    @property
    def instances(self) -> Mapping[str, Estimator]:
        """Estimators that are objects, by the text that stands for them in `estimators`."""
        return self._instances

    def with_estimators(self, estimators: Iterable[str | Estimator]) -> Self:
        """Return a suite with other estimators: specifications, or objects.

        Raises
        ------
        InputError
            If one is neither, or listed twice.
        """
        spelled = spelled_estimators(estimators)
        suite = self.replace(estimators=list(spelled))
        suite._instances = Instances({text: one for text, one in spelled.items() if one is not None})
        return suite

    def replace(self, **changes: Any) -> Self:
        """Return a suite with other values for some keys; a change of None keeps the value.

        New SNRs of one sort take the place of those of the other. Estimators
        that are objects stay as long as the estimators do.

        Raises
        ------
        InputError
            If a new value is not allowed.
        """
        given = {key: value for key, value in changes.items() if value is not None}
        kept = self.model_dump()
        for key, other in (("snr_db", "snr_gain_db"), ("snr_gain_db", "snr_db")):
            if key in given:
                kept[other] = None
        try:
            suite = self.model_validate({**kept, **given})
        except ValidationError as error:
            raise InputError(describe_mistake(error, type(self))) from error
        kept_instances = {text: one for text, one in self._instances.items() if text in suite.estimators}
        suite._instances = Instances(kept_instances)
        return suite


class ResolutionSuite(Suite):
    """Suite of the kind ``resolution``.

    Attributes
    ----------
    dimensions : tuple of {"range", "velocity", "u", "w"}
        In which pairs of scatterers differ, one at a time.
    separations_cells : tuple of float
        By how many Rayleigh cells.
    phases_deg : tuple of float
        Phases between the two at the centre of resource grid and array.
    """

    KINDS: ClassVar[tuple[StudyKind, ...]] = ("resolution",)

    kind: StudyKind = "resolution"
    dimensions: Annotated[tuple[Dimension, ...], Field(min_length=1)] = get_args(Dimension)
    separations_cells: Annotated[tuple[Separation, ...], Field(min_length=1)]
    phases_deg: Annotated[tuple[Phase, ...], Field(min_length=1)] = (0.0,)

    @field_validator("dimensions", "separations_cells", "phases_deg")
    @classmethod
    def _refuse_repeated_scenes(cls, values: tuple[Any, ...]) -> tuple[Any, ...]:
        """Refuse a repeated entry, which would yield two scenes of one name."""
        return _unrepeated(values)


class DetectionSuite(Suite):
    """Suite of the kind ``detection``.

    Attributes
    ----------
    detectors : tuple of str
        Detectors as ``name[param=value,...]``: alone on the maps, and before
        every estimator on the scenarios.
    maps : tuple of str
        Synthetic maps, see `isacbench.bench.studies.power_maps.draw_power_map`.
    pfa : tuple of float
        Nominal probabilities of false alarm on the maps; none takes each
        detector's own.
    """

    KINDS: ClassVar[tuple[StudyKind, ...]] = ("detection",)

    kind: StudyKind = "detection"
    detectors: Names
    maps: tuple[MapName, ...] = get_args(MapName)
    pfa: tuple[Pfa, ...] = ()

    @field_validator("detectors", "maps", "pfa")
    @classmethod
    def _refuse_repeated_entries(cls, values: tuple[Any, ...]) -> tuple[Any, ...]:
        """Refuse a repeated entry, which would yield two rows with the same key."""
        return _unrepeated(values)


class LinkSuite(Suite):
    """Suite of the kind ``link``.

    Attributes
    ----------
    modulations : tuple of {"qpsk", "16qam", "64qam", "256qam"}
        Of the data that is sent, received, and sensed with.
    sensing : tuple of {"all", "prs"}
        Resource elements that are sensed with.
    divisions : tuple of {"reciprocal", "matched", "wiener"}
        How the echo is divided by symbols of unequal power.
    channels : tuple of str
        Channels to the user as ``name[param=value,...]``: ``awgn``,
        ``two_ray`` and ``tapped_delay``, see `isacbench.link.reception.channel`.
    receivers : tuple of str
        Of the user, likewise: ``one_tap``, see `isacbench.bench.studies.link_reception.OneTap`.
    """

    KINDS: ClassVar[tuple[StudyKind, ...]] = ("link",)

    kind: StudyKind = "link"
    modulations: Annotated[tuple[Modulation, ...], Field(min_length=1)] = get_args(Modulation)
    sensing: Annotated[tuple[Sensing, ...], Field(min_length=1)] = get_args(Sensing)
    divisions: Annotated[tuple[Division, ...], Field(min_length=1)] = get_args(Division)
    channels: tuple[str, ...] = ("awgn", "two_ray", "tapped_delay")
    receivers: Annotated[tuple[str, ...], Field(min_length=1)] = ("one_tap[knowledge=perfect]", "one_tap")

    @field_validator("modulations", "sensing", "divisions", "channels", "receivers")
    @classmethod
    def _refuse_repeated_signals(cls, values: tuple[Any, ...]) -> tuple[Any, ...]:
        """Refuse a repeated entry, which would yield two scenes of one name."""
        return _unrepeated(values)


class _KindOnly(BaseModel):
    """The one key by which the others are told."""

    kind: StudyKind = "imaging"


SUITES: tuple[type[Suite], ...] = (Suite, ResolutionSuite, DetectionSuite, LinkSuite)


def suite_names() -> list[str]:
    """Names of the built-in suites, sorted."""
    return builtin_names(FOLDER)


def find_suite(name_or_path: str | Path) -> Path:
    """Find the file of a suite by its built-in name or by its path.

    Raises
    ------
    InputError
        If there is no such name or file.
    """
    return find_toml(name_or_path, "suite", FOLDER)


def load_suite(name_or_path: str | Path) -> Suite:
    """Load a built-in suite by name, or any by the path of its TOML file.

    Parameters
    ----------
    name_or_path : str or Path
        A name that `suite_names` lists, or a path that ends in ``.toml``.

    Returns
    -------
    Suite
        With the paths of scenarios resolved against the suite's own folder.

    Raises
    ------
    InputError
        Naming file, key, value and what is allowed.

    Examples
    --------
    >>> load_suite("paper").trials
    10
    """
    path = find_suite(name_or_path)
    suite = read_toml(path, _suite_class(read_toml(path, _KindOnly).kind))
    scenarios = tuple(
        str(path.parent / scenario) if scenario.endswith(".toml") else scenario
        for scenario in suite.scenarios
    )
    return suite.model_copy(update={"scenarios": scenarios})


def restore_suite(content: Mapping[str, Any]) -> Suite:
    """Build a suite from what its ``model_dump`` gave; a kind that is missing is ``imaging``.

    Raises
    ------
    ValueError
        If it is none.
    """
    return _suite_class(_KindOnly.model_validate(content).kind).model_validate(content)


def parse_snr(text: str) -> tuple[float, ...]:
    """Parse SNRs in dB: ``start:stop:step`` with both ends, a list ``-5,0,10``, or one number.

    Raises
    ------
    InputError
        Quoting the text and saying what is allowed.

    Examples
    --------
    >>> parse_snr("-10:10:5")
    (-10.0, -5.0, 0.0, 5.0, 10.0)
    """
    separator = ":" if ":" in text else ","
    try:
        numbers = [float(part) for part in text.split(separator)]
    except ValueError:
        numbers = []
    in_range = all(-MAX_SNR_DB <= number <= MAX_SNR_DB for number in numbers)
    if not numbers or not in_range or (separator == ":" and len(numbers) != 3):
        raise InputError(
            f"SNR {text!r}: allowed are start:stop:step such as -30:20:5, a list such as -5,0,10, "
            f"or one number, in dB, from {-MAX_SNR_DB:g} to {MAX_SNR_DB:g}"
        )
    if separator == ",":
        return tuple(numbers)
    try:
        return _grid(*numbers)
    except ValueError as error:
        raise InputError(f"SNR {text!r}: {error}") from error


def _suite_class(kind: StudyKind) -> type[Suite]:
    return next(suite for suite in SUITES if kind in suite.KINDS)


def _unrepeated(values: tuple[Any, ...]) -> tuple[Any, ...]:
    repeated = [value for index, value in enumerate(values) if value in values[:index]]
    if repeated:
        raise ValueError(f"{repeated[0]!r} is listed twice")
    return values


def _grid(start: float, stop: float, step: float) -> tuple[float, ...]:
    """Evenly spaced numbers with both ends; an end that is missed by rounding alone is kept."""
    if not (math.isfinite(start) and math.isfinite(stop) and math.isfinite(step)):
        raise ValueError("start, stop and step must be finite")
    if step <= 0:
        raise ValueError(f"the step must be positive, not {step:g}")
    if stop < start:
        raise ValueError(f"the stop {stop:g} must not lie below the start {start:g}")
    n_steps = math.floor((stop - start) / step + 1e-9)
    if n_steps >= MAX_GRID_POINTS:
        raise ValueError(f"{n_steps + 1} values; allowed are at most {MAX_GRID_POINTS}")
    return tuple(round(start + index * step, 9) + 0.0 for index in range(n_steps + 1))
