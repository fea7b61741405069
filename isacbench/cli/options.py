"""Options that several commands share, and the check of the names in them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from collections.abc import Iterable

EstimatorSpecs = Annotated[
    list[str] | None,
    typer.Option(
        "-e",
        "--estimator",
        metavar="NAME[param=value,...]",
        help="Estimator, instead of the suite's; repeats. A value [a,b] stands for each.",
    ),
]
PluginFiles = Annotated[
    list[Path] | None,
    typer.Option("--plugin", metavar="FILE.py", help="Local file with estimators or detectors; repeats."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON and nothing else.")]
OUT_HELP = "Folder, new or of the same run, which then goes on; default results/<suite>-<time>."
SEED_HELP = "Seed that all noise follows from."
ScenarioNames = Annotated[
    list[str] | None,
    typer.Option("-s", "--scenario", metavar="SCENARIO", help="Scenario, name or .toml path, likewise."),
]


def register(plugin_files: list[Path] | None) -> None:
    """Register local plugin files."""
    from isacbench.plugins.discovery import load_plugin_file

    for path in plugin_files or ():
        load_plugin_file(path)


def require_names(
    scenarios: Iterable[str] = (), estimators: Iterable[str] = (), detectors: Iterable[str] = ()
) -> None:
    """Refuse names that do not exist, before anything is started or anything slow is imported."""
    from isacbench.files.toml_files import find_toml
    from isacbench.plugins.registry import require_plugins

    for scenario in scenarios:
        find_toml(scenario, "scenario")
    require_plugins("estimator", estimators)
    require_plugins("detector", detectors)
