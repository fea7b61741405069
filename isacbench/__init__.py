"""How accurate and how fast: a benchmark of radar imaging with 5G downlink signals.

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

if TYPE_CHECKING:
    from isacbench.bench.compare import compare
    from isacbench.bench.comparison import Comparison
    from isacbench.bench.pairing import NotComparableError
    from isacbench.bench.runner import run
    from isacbench.bench.stored_run import load_run
    from isacbench.conformance import check
    from isacbench.cubes.observing import observe_cube
    from isacbench.errors import InputError
    from isacbench.metrics.score import score
    from isacbench.model.cloud import PointCloud
    from isacbench.model.observation import Observation
    from isacbench.model.scenario import Scenario, load_scenario
    from isacbench.observing import observe
    from isacbench.registry import get_detector, get_estimator
    from isacbench.report.plotting import plot_clouds

__version__ = "0.1.0"

__all__ = [
    "Comparison",
    "InputError",
    "NotComparableError",
    "Observation",
    "PointCloud",
    "Scenario",
    "__version__",
    "check",
    "compare",
    "get_detector",
    "get_estimator",
    "load_run",
    "load_scenario",
    "observe",
    "observe_cube",
    "plot_clouds",
    "run",
    "score",
]

# Where each public name lives: loaded on first use, so that the command line starts without NumPy.
_HOMES = {
    "Comparison": "isacbench.bench.comparison",
    "InputError": "isacbench.errors",
    "NotComparableError": "isacbench.bench.pairing",
    "Observation": "isacbench.model.observation",
    "PointCloud": "isacbench.model.cloud",
    "Scenario": "isacbench.model.scenario",
    "compare": "isacbench.bench.compare",
    "check": "isacbench.conformance",
    "get_detector": "isacbench.registry",
    "get_estimator": "isacbench.registry",
    "load_run": "isacbench.bench.stored_run",
    "load_scenario": "isacbench.model.scenario",
    "observe": "isacbench.observing",
    "observe_cube": "isacbench.cubes.observing",
    "plot_clouds": "isacbench.report.plotting",
    "run": "isacbench.bench.runner",
    "score": "isacbench.metrics.score",
}


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
