"""Options that several commands share, the completion of the names in them, and their check."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from itertools import chain
from pathlib import Path
from pkgutil import resolve_name
from typing import Annotated, Any

from typer import Argument, Option


def like(*names: str | Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """Return the completion of some names, or of those that functions ``module:function`` list."""

    def complete(incomplete: str) -> list[str]:
        lists = (resolve_name(one)() if isinstance(one, str) else one() for one in names)
        return [name for name in chain.from_iterable(lists) if name.startswith(incomplete)]

    return complete


def _families() -> list[str]:
    from isacbench.model.scenes.scene_families import FAMILIES

    return [f"{family}[seed=" for family in FAMILIES]


def _curves() -> list[str]:
    """Scores with a curve over SNR."""
    from isacbench.metrics.paper import Paper

    return [column.name for column in Paper.columns if column.better != "neither"]


estimators_like = like("isacbench.plugins.registry:estimator_names")
plugin_metrics_like = like("isacbench.plugins.registry:metric_names")
scenarios_like = like("isacbench.files.toml_files:builtin_names", _families)
suites_like = like("isacbench.bench.suites.suite:suite_names")
curves_like = like(_curves)
metrics_like = like(_curves, lambda: ["ratio", "time_estimate_s"])

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
