"""Scores of a run: the metrics that a suite asks for, and what a manifest keeps of their columns."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from isacbench.bench.cells.record import COLUMNS
from isacbench.bench.suites.suite_kinds import kind_of
from isacbench.errors import InputError
from isacbench.metrics.descriptions import ScoreColumn
from isacbench.plugins.scoring import Metrics, object_kinds

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from isacbench.bench.suites.suite import Suite
    from isacbench.model.scene import Scenario

SCORES = "scores"
"""Key of a manifest with the metrics and their columns."""


def metrics_of(suite: Suite) -> Metrics:
    """Metrics that images of a suite are scored by."""
    return kind_of(suite).metrics_of(suite)


def describe_scores(metrics: Metrics, scenarios: Iterable[Scenario]) -> dict[str, Any]:
    """Describe metrics and their columns for a manifest; scenarios have the kinds of objects."""
    kinds = sorted({kind for scenario in scenarios for kind in object_kinds(scenario)})
    columns = {name: asdict(column) for name, column in metrics.columns(kinds).items()}
    for column in columns.values():
        if column["empty"] is not None and math.isnan(column["empty"]):
            column["empty"] = "none"  # JSON has no NaN
    return {"metrics": metrics.described(), "columns": columns}


def stored_columns(manifest: Mapping[str, Any]) -> dict[str, ScoreColumn]:
    """Columns of the scores of a run by their names in rows, as its manifest describes them."""
    return {
        name: ScoreColumn(**{**column, "empty": math.nan if column["empty"] == "none" else column["empty"]})
        for name, column in manifest[SCORES]["columns"].items()
    }


def row_columns(suite: Suite, described: Mapping[str, Any]) -> dict[str, Any]:
    """Columns that the rows of a run have besides `COLUMNS`, each with its value for rows without it.

    `described` are its scores, as `describe_scores` or `stored_columns` have them, by the names of columns.
    """
    further = [name for name in described if name not in COLUMNS]
    return {"label": "", **kind_of(suite).columns, **dict.fromkeys(further, math.nan)}


def require_same_scores(manifest: Mapping[str, Any], metrics: Metrics) -> None:
    """Refuse a run whose cells were scored by other metrics, or other versions of them, naming the metric."""
    if SCORES not in manifest:  # damaged
        return
    wanted, stored = metrics.described(), stored_metrics(manifest)
    for name in wanted | stored:
        if wanted.get(name) != stored.get(name):
            found, now = (
                spell_metric(each[name]) if name in each else "not at all" for each in (stored, wanted)
            )
            raise InputError(
                f"its cells were scored by the metric {name}: {found}, wanted: {now}; "
                + ("rescore it first (isacbench rescore)" if name in wanted else f"add --metric {name}")
                + ", or use a new folder"
            )


def stored_metrics(manifest: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Version and parameters of the metrics of a run, by name."""
    found: dict[str, dict[str, Any]] = manifest[SCORES]["metrics"]
    return found


def spell_metric(metric: Mapping[str, Any]) -> str:
    """Spell version and parameters of a metric."""
    params = "".join(f", {key} = {value}" for key, value in metric["params"].items())
    return f"version {metric['version']}{params}"
