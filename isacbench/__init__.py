"""Benchmark of the accuracy and the speed of radar imaging with 5G downlink signals.

Examples
--------
>>> import isacbench
>>> scenario = isacbench.load_scenario("street")
>>> observation = isacbench.observe(scenario, snr_db=10)
>>> cloud = isacbench.get_estimator("music2d").estimate(observation)
>>> scores = isacbench.score(scenario.truth, cloud)
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from isacbench.checkout import keep_to_checkout

if TYPE_CHECKING:
    from isacbench.bench.compare.comparison import Comparison, compare
    from isacbench.bench.compare.pairs import NotComparableError
    from isacbench.bench.compare.ranking import Ranking, rank
    from isacbench.bench.run.runner import run
    from isacbench.bench.store.run import load_run
    from isacbench.checking.plugin_check import check
    from isacbench.cubes.frame import observe_cube
    from isacbench.errors import InputError
    from isacbench.link.sensing.observing import observe
    from isacbench.model.cloud import PointCloud
    from isacbench.model.observation import Observation
    from isacbench.model.scene import Scenario
    from isacbench.model.scenes.scenario import load_scenario
    from isacbench.plugins.registry import get_detector, get_estimator, get_metric
    from isacbench.plugins.scoring import score
    from isacbench.report.clouds import plot_clouds

__version__ = "0.2.0"

__all__ = [
    "Comparison",
    "InputError",
    "NotComparableError",
    "Observation",
    "PointCloud",
    "Ranking",
    "Scenario",
    "__version__",
    "check",
    "compare",
    "get_detector",
    "get_estimator",
    "get_metric",
    "load_run",
    "load_scenario",
    "observe",
    "observe_cube",
    "plot_clouds",
    "rank",
    "run",
    "score",
]

# Modules of the public names: loaded on first use, so that the command line starts without NumPy.
_HOMES = {
    "Comparison": "isacbench.bench.compare.comparison",
    "InputError": "isacbench.errors",
    "NotComparableError": "isacbench.bench.compare.pairs",
    "Observation": "isacbench.model.observation",
    "PointCloud": "isacbench.model.cloud",
    "Ranking": "isacbench.bench.compare.ranking",
    "Scenario": "isacbench.model.scenes.scenario",
    "compare": "isacbench.bench.compare.comparison",
    "check": "isacbench.checking.plugin_check",
    "get_detector": "isacbench.plugins.registry",
    "get_estimator": "isacbench.plugins.registry",
    "get_metric": "isacbench.plugins.registry",
    "load_run": "isacbench.bench.store.run",
    "load_scenario": "isacbench.model.scenes.scenario",
    "observe": "isacbench.link.sensing.observing",
    "observe_cube": "isacbench.cubes.frame",
    "plot_clouds": "isacbench.report.clouds",
    "rank": "isacbench.bench.compare.ranking",
    "run": "isacbench.bench.run.runner",
    "score": "isacbench.plugins.scoring",
}

keep_to_checkout()


def __getattr__(name: str) -> object:
    """Load a public name on first use (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value: object = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names, loaded or not."""
    return sorted({*globals(), *__all__})
