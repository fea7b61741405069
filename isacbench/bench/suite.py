"""Suites: which estimators meet which scenarios at which SNR, and how often."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from isacbench.errors import InputError
from isacbench.tomlfile import builtin_names, describe_mistake, find_toml, read_toml

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["Suite", "find_suite", "load_suite", "parse_snr", "suite_names"]

FOLDER = "suites"
MAX_GRID_POINTS = 1000
"""More SNRs than any curve needs: a larger grid is a slip of the pen."""

MAX_SNR_DB = 300.0
"""Beyond it, of either sign, double precision holds the noise alone or the echo alone."""

Names = Annotated[tuple[str, ...], Field(min_length=1)]
SnrDb = Annotated[float, Field(ge=-MAX_SNR_DB, le=MAX_SNR_DB)]


class Suite(BaseModel):
    """What a run consists of.

    Attributes
    ----------
    name : str
    scenarios : tuple of str
        Names of built-in scenarios, or paths that end in ``.toml``.
    estimators : tuple of str
        Estimators as ``name[param=value,...]``.
    snr_db : tuple of float
        SNRs in dB. A suite file may give a table ``{start, stop, step}``.
    trials : int
        Noise draws for each scenario and SNR.
    seed : int
        Seed that all noise follows from.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Annotated[str, Field(pattern=r"^[\w.-]+$")]
    scenarios: Names
    estimators: Names
    snr_db: Annotated[tuple[SnrDb, ...], Field(min_length=1)]
    trials: Annotated[int, Field(ge=1)]
    seed: Annotated[int, Field(ge=0)] = 0

    @field_validator("snr_db", mode="before")
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

    @field_validator("scenarios", "estimators", "snr_db")
    @classmethod
    def _refuse_repeats(cls, values: tuple[Any, ...]) -> tuple[Any, ...]:
        """Refuse a repeated entry, which would yield two rows with the same key."""
        repeated = [value for index, value in enumerate(values) if value in values[:index]]
        if repeated:
            raise ValueError(f"{repeated[0]!r} is listed twice")
        return values

    def replace(self, **changes: Any) -> Self:
        """Return a suite with other values for some keys; a change of None keeps the value.

        Raises
        ------
        InputError
            If a new value is not allowed.
        """
        given = {key: value for key, value in changes.items() if value is not None}
        try:
            return self.model_validate({**self.model_dump(), **given})
        except ValidationError as error:
            raise InputError(describe_mistake(error, type(self))) from error


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
    suite = read_toml(path, Suite)
    scenarios = tuple(
        str(path.parent / scenario) if scenario.endswith(".toml") else scenario
        for scenario in suite.scenarios
    )
    return suite.model_copy(update={"scenarios": scenarios})


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
