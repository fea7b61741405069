"""Options that several commands share, the completion of the names in them, and their check."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option


def estimators_like(incomplete: str) -> list[str]:
    """List the registered estimators whose names begin with a text."""
    from isacbench.plugins.registry import estimator_names

    return _like(estimator_names(), incomplete)


def plugin_metrics_like(incomplete: str) -> list[str]:
    """List the registered metrics whose names begin with a text."""
    from isacbench.plugins.registry import metric_names

    return _like(metric_names(), incomplete)


def scenarios_like(incomplete: str) -> list[str]:
    """List the scenarios and families, these with ``[seed=``, whose names begin with a text."""
    from isacbench.model.scenes.scenario import scenario_names
    from isacbench.model.scenes.scene_families import FAMILIES

    return _like([*scenario_names(), *(f"{family}[seed=" for family in FAMILIES)], incomplete)


def suites_like(incomplete: str) -> list[str]:
    """List the suites whose names begin with a text."""
    from isacbench.bench.suites.suite import suite_names

    return _like(suite_names(), incomplete)


def metrics_like(incomplete: str) -> list[str]:
    """List the scores that estimators are ranked by whose names begin with a text."""
    return [*curves_like(incomplete), *_like(["ratio", "time_estimate_s"], incomplete)]


def curves_like(incomplete: str) -> list[str]:
    """List the scores with a curve over SNR whose names begin with a text."""
    from isacbench.metrics.paper import Paper

    return _like([column.name for column in Paper.columns if column.better != "neither"], incomplete)


def _like(names: list[str], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]


SPEC = "NAME[param=value,...]"
estimator_option: Any = partial(Option, "-e", "--estimator", metavar=SPEC, autocompletion=estimators_like)
metric_option: Any = partial(Option, metavar=SPEC, autocompletion=plugin_metrics_like)
scenario_option: Any = partial(Option, "-s", "--scenario", metavar="SCENARIO", autocompletion=scenarios_like)
out_option: Any = partial(Option, "-o", "--out")
EstimatorName = Annotated[str, estimator_option(help="Estimator.")]
EstimatorSpecs = Annotated[
    list[str] | None, estimator_option(help="Estimator; repeats. A value [a,b] means each of both.")
]
PluginFiles = Annotated[
    list[Path] | None, Option("--plugin", metavar="FILE.py", help="Local file with plugins; repeats.")
]
MetricSpecs = Annotated[list[str] | None, metric_option(help="Further metric of every image; repeats.")]
AsJson = Annotated[bool, Option("--json", help="Print JSON and nothing else.")]
MixVersions = Annotated[
    bool, Option("--mix-versions", help="Keep rows of an estimator that several code versions made.")
]
SEED_HELP = "Seed of all noise."
Seed = Annotated[int, Option(min=0, help=SEED_HELP)]
OptionalSeed = Annotated[int | None, Option(min=0, help=SEED_HELP)]
SuiteName = Annotated[
    str, Argument(metavar="[SUITE]", help="Suite by name or .toml path.", autocompletion=suites_like)
]
html_option: Any = partial(Option, "--html/--no-html")
Html = Annotated[bool, html_option(help="Whether to write the interactive page.")]
ScenarioName = Annotated[str, scenario_option(help="Name, .toml path or family[seed=7,...].")]
ScenarioNames = Annotated[
    list[str] | None, scenario_option(help="Name, .toml path or family[seed=0:99,...]; repeats.")
]


def register(plugin_files: list[Path] | None) -> None:
    """Register local plugin files."""
    from isacbench.plugins.discovery import load_plugin_file

    for path in plugin_files or ():
        load_plugin_file(path)


def require_names(
    scenarios: Iterable[str] | None = None,
    estimators: Iterable[str] | None = None,
    detectors: Iterable[str] | None = None,
    metrics: Iterable[str] | None = None,
) -> None:
    """Refuse names and specifications of what does not exist, before anything slow is imported or started."""
    from isacbench.model.scenes.scene_families import scenario_variants
    from isacbench.plugins.registry import require_plugins

    for scenario in scenarios or ():
        scenario_variants(scenario)
    require_plugins("estimator", estimators or ())
    require_plugins("detector", detectors or ())
    require_plugins("metric", metrics or ())
