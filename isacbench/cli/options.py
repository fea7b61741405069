"""Options that several commands share, and the check of the names in them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from isacbench.cli.completion import estimators_like, plugin_metrics_like, scenarios_like, suites_like

if TYPE_CHECKING:
    from collections.abc import Iterable

SPEC = "NAME[param=value,...]"
EstimatorSpecs = Annotated[
    list[str] | None,
    Option(
        "-e",
        "--estimator",
        metavar=SPEC,
        help="Estimator; repeats. A value [a,b] means each of both.",
        autocompletion=estimators_like,
    ),
]
PluginFiles = Annotated[
    list[Path] | None,
    Option("--plugin", metavar="FILE.py", help="Local file with plugins; repeats."),
]
MetricSpecs = Annotated[
    list[str] | None,
    Option(
        "--metric",
        metavar=SPEC,
        help="Further metric of every image; repeats.",
        autocompletion=plugin_metrics_like,
    ),
]
AsJson = Annotated[bool, Option("--json", help="Print JSON and nothing else.")]
MixVersions = Annotated[
    bool, Option("--mix-versions", help="Keep rows of an estimator that several code versions made.")
]
OUT_HELP = "Folder, new or of the same run to go on with; default results/<suite>-<time>."
SEED_HELP = "Seed of all noise."
Seed = Annotated[int, Option(min=0, help=SEED_HELP)]
SuiteName = Annotated[
    str, Argument(metavar="[SUITE]", help="Suite by name or .toml path.", autocompletion=suites_like)
]
Html = Annotated[bool, Option("--html/--no-html", help="Whether to write the interactive page.")]
ScenarioName = Annotated[
    str,
    Option(
        "-s",
        "--scenario",
        metavar="SCENARIO",
        help="Name, .toml path or family[seed=7,...].",
        autocompletion=scenarios_like,
    ),
]
ScenarioNames = Annotated[
    list[str] | None,
    Option(
        "-s",
        "--scenario",
        metavar="SCENARIO",
        help="Name, .toml path or family[seed=0:99,...]; repeats.",
        autocompletion=scenarios_like,
    ),
]


def register(plugin_files: list[Path] | None) -> None:
    """Register local plugin files."""
    from isacbench.plugins.discovery import load_plugin_file

    for path in plugin_files or ():
        load_plugin_file(path)


def require_names(
    scenarios: Iterable[str] = (),
    estimators: Iterable[str] = (),
    detectors: Iterable[str] = (),
    metrics: Iterable[str] = (),
) -> None:
    """Refuse names that do not exist, before anything is started or anything slow is imported.

    Parameters
    ----------
    scenarios, estimators, detectors, metrics : iterable of str
        Names or specifications.

    Raises
    ------
    InputError
        If one does not exist.
    """
    from isacbench.model.scenes.scene_families import scenario_variants
    from isacbench.plugins.registry import require_plugins

    for scenario in scenarios:
        scenario_variants(scenario)
    require_plugins("estimator", estimators)
    require_plugins("detector", detectors)
    require_plugins("metric", metrics)
