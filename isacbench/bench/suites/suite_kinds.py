"""The kinds of suites by name, and suites read from files and manifests."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import BaseModel, field_validator

from isacbench.bench.kinds.detection import DetectionKind
from isacbench.bench.kinds.efficiency import EfficiencyKind
from isacbench.bench.kinds.imaging import ImagingKind
from isacbench.bench.kinds.link import LinkKind
from isacbench.bench.kinds.population import PopulationKind
from isacbench.bench.kinds.resolution import ResolutionKind
from isacbench.bench.suites.suite import Suite, find_suite
from isacbench.errors import InputError
from isacbench.files.toml_files import read_toml
from isacbench.specifications import parse_spec

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from isacbench.bench.kinds.kind import Kind

S = TypeVar("S", bound=Suite)

KINDS: dict[str, Kind] = {
    kind.name: kind()
    for kind in (ImagingKind, EfficiencyKind, ResolutionKind, DetectionKind, LinkKind, PopulationKind)
}
"""Kinds of suites by the value of the key ``kind``. A new one is entered here, and nowhere else."""

PLANNERS = tuple(type(kind).__module__ for kind in KINDS.values())
"""Modules that plan scenes and measure them: the code of the kinds that rows follow from."""


class _KindOnly(BaseModel):
    """Key that decides which other keys a suite has."""

    kind: str = ImagingKind.name

    @field_validator("kind")
    @classmethod
    def _require_known(cls, value: str) -> str:
        if value not in KINDS:
            raise ValueError(f"allowed are {', '.join(map(repr, KINDS))}")
        return value


def kind_of(suite: Suite) -> Kind:
    """Look up the kind of a suite.

    Raises
    ------
    InputError
        If there is no such kind, or its suites are of another class.
    """
    kind = KINDS.get(suite.kind)
    if kind is None or type(suite) is not kind.suite:
        allowed = ", ".join(f"{name!r} with {one.suite.__name__}" for name, one in KINDS.items())
        raise InputError(f"kind = {suite.kind!r} with {type(suite).__name__}: allowed are {allowed}")
    return kind


def with_metrics(suite: S, further: str | Iterable[str]) -> S:
    """Give a suite further metrics, each in place of one of the same name.

    Parameters
    ----------
    further : str or iterable of str
        As ``name[param=value,...]``.

    Returns
    -------
    Suite
        The same if there are none.
    """
    added = (further,) if isinstance(further, str) else tuple(further)
    named = {parse_spec(spec).name: spec for spec in (*kind_of(suite).metric_specs(suite), *added)}
    return suite.replace(metrics=tuple(named.values())) if added else suite


def load_suite(name_or_path: str | Path) -> Suite:
    """Load a built-in suite by name, or any suite by the path of its TOML file.

    Parameters
    ----------
    name_or_path : str or Path
        A name that `isacbench.bench.suites.suite.suite_names` lists, or a path that ends in ``.toml``.

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
    suite = read_toml(path, KINDS[read_toml(path, _KindOnly).kind].suite)
    scenarios = tuple(
        str(path.parent / scenario) if scenario.endswith(".toml") else scenario
        for scenario in suite.scenarios
    )
    return suite.model_copy(update={"scenarios": scenarios})


def restore_suite(content: Mapping[str, Any]) -> Suite:
    """Build a suite from the result of its ``model_dump``; a missing kind is ``imaging``.

    Raises
    ------
    ValueError
        If the content describes no suite.
    """
    return KINDS[_KindOnly.model_validate(content).kind].suite.model_validate(content)
