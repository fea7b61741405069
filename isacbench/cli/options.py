"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["OUT_HELP", "SEED_HELP", "AsJson", "EstimatorSpecs", "PluginFiles", "ScenarioNames", "register"]

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
    from isacbench.entries import load_plugin_file

    for path in plugin_files or ():
        load_plugin_file(path)
