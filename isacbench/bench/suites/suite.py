"""Suites: which estimators meet which scenarios at which SNR, and how often."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Self, TypeVar

from pydantic import AfterValidator, BaseModel, Field, ValidationError, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

from isacbench.errors import InputError
from isacbench.files.toml_files import builtin_names, describe_mistake, find_toml
from isacbench.plugins.contracts import Estimator
from isacbench.plugins.pickling import PickledEstimators
from isacbench.plugins.registry import spelled_estimators
from isacbench.specifications import is_number

FOLDER = "suites"
MAX_GRID_POINTS = 1000
"""More SNRs than any curve needs: a larger grid is a slip of the pen."""

MAX_NAME = 200
"""Characters of a name, which becomes a part of the name of a folder."""

MAX_SNR_DB = 300.0
"""Beyond it, of either sign, double precision holds the noise alone or the echo alone."""

Item = TypeVar("Item")


def refuse_repeats(values: tuple[Item, ...]) -> tuple[Item, ...]:
    """Refuse a repeated entry, which would yield two rows with the same key; return the same."""
    for index, value in enumerate(values):
        if value in values[:index]:
            raise ValueError(f"{value!r} is listed twice")
    return values


Distinct = Annotated[tuple[Item, ...], AfterValidator(refuse_repeats)]
"""Key that takes a list of different entries, or an empty one."""

Listed = Annotated[tuple[Item, ...], Field(min_length=1), AfterValidator(refuse_repeats)]
"""Key that takes a list of one or more different entries."""

Snrs = Listed[Annotated[float, Field(ge=-MAX_SNR_DB, le=MAX_SNR_DB)]]


class Suite(BaseModel, extra="forbid", frozen=True):
    """Plan of a run: which estimators meet which scenarios at which SNR, and how often.

    Attributes
    ----------
    kind : str
        A name in `isacbench.bench.suites.suite_kinds.KINDS`: what is made of the scenarios and
        measured. Kinds with keys of their own have a class of their own.
    scenarios : tuple of str
        Names of built-in scenarios, or paths that end in ``.toml``.
    estimators : tuple of str
        Estimators as ``name[param=value,...]``.
    metrics : tuple of str or None
        Metrics that score the images beside ``paper``, as ``name[param=value,...]``; None for those of
        the kind.
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

    _instances: PickledEstimators = PickledEstimators()

    kind: str = "imaging"
    name: Annotated[str, Field(pattern=r"^[\w.-]+$", max_length=MAX_NAME)]
    scenarios: Listed[str]
    estimators: Listed[str]
    metrics: Distinct[str] | None = None
    snr_gain_db: Snrs | None = None
    snr_db: Annotated[Snrs | None, Field(validate_default=True)] = None
    trials: Annotated[int, Field(ge=1)]
    seed: Annotated[int, Field(ge=0)] = 0

    @field_validator("snr_db", "snr_gain_db", mode="before")
    @classmethod
    def _expand_grid(cls, value: Any) -> Any:
        """Turn a table ``{start, stop, step}`` into the list it stands for."""
        if not isinstance(value, dict):
            return value
        if set(value) != {"start", "stop", "step"} or not {*map(type, value.values())} <= {int, float}:
            raise ValueError("a table takes three numbers, start, stop and step")
        return _grid(**value)

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
        """Return a suite with other estimators, each a specification or an object."""
        spelled = spelled_estimators(estimators)
        suite = self.replace(estimators=list(spelled))
        suite._instances = PickledEstimators({text: one for text, one in spelled.items() if one is not None})
        return suite

    def replace(self, **changes: Any) -> Self:
        """Return a suite with other values for some keys; None keeps the value.

        New SNRs of one sort take the place of those of the other. Estimators
        that are objects stay as long as the estimators do.
        """
        given = {key: value for key, value in changes.items() if value is not None}
        kept = self.model_dump()
        if {"snr_db", "snr_gain_db"} & given.keys():
            kept |= {"snr_db": None, "snr_gain_db": None}
        try:
            suite = self.model_validate({**kept, **given})
        except ValidationError as error:
            raise InputError(describe_mistake(error, type(self))) from error
        kept_estimators = {text: one for text, one in self._instances.items() if text in suite.estimators}
        suite._instances = PickledEstimators(kept_estimators)
        return suite


def suite_names() -> list[str]:
    """Names of the built-in suites, sorted."""
    return builtin_names(FOLDER)


def find_suite(name_or_path: str | Path) -> Path:
    """Find the file of a suite by its built-in name or its path."""
    return find_toml(name_or_path, "suite", FOLDER)


def parse_snr(text: str) -> tuple[float, ...]:
    """Parse SNRs in dB: ``start:stop:step`` with both ends, a list ``-5,0,10``, or one number.

    Examples
    --------
    >>> parse_snr("-10:10:5")
    (-10.0, -5.0, 0.0, 5.0, 10.0)
    """
    separator = ":" if ":" in text else ","
    parts = text.split(separator)
    numbers = [float(part) for part in parts] if all(map(is_number, parts)) else []
    in_range = all(-MAX_SNR_DB <= number <= MAX_SNR_DB for number in numbers)
    if not numbers or not in_range or (separator == ":" and len(numbers) != 3):
        raise InputError(
            f"SNR {text!r}: allowed are start:stop:step such as -30:20:5, a list such as -5,0,10, "
            f"or one number, in dB, from {-MAX_SNR_DB:g} to {MAX_SNR_DB:g}"
        )
    try:
        return tuple(numbers) if separator == "," else _grid(*numbers)
    except ValueError as error:
        raise InputError(f"SNR {text!r}: {error}") from error


def _grid(start: float, stop: float, step: float) -> tuple[float, ...]:
    """Evenly spaced numbers with both ends; an end that is missed by rounding alone is kept."""
    if not (0 < step < math.inf and -math.inf < start <= stop < math.inf):
        raise ValueError("start, stop and step must be finite, step positive, and stop no less than start")
    n_steps = math.floor((stop - start) / step + 1e-9)
    if n_steps >= MAX_GRID_POINTS:
        raise ValueError(f"{n_steps + 1} values; allowed are at most {MAX_GRID_POINTS}")
    return tuple(round(start + index * step, 9) + 0.0 for index in range(n_steps + 1))
