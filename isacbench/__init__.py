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
    from isacbench.bench.compare.comparison import Comparison as Comparison
    from isacbench.bench.compare.comparison import compare as compare
    from isacbench.bench.compare.pairs import NotComparableError as NotComparableError
    from isacbench.bench.compare.ranking import Ranking as Ranking
    from isacbench.bench.compare.ranking import rank as rank
    from isacbench.bench.run.runner import run as run
    from isacbench.bench.store.run import load_run as load_run
    from isacbench.checking.plugin_check import check as check
    from isacbench.cubes.frame import observe_cube as observe_cube
    from isacbench.errors import InputError as InputError
    from isacbench.link.sensing.observing import observe as observe
    from isacbench.model.cloud import PointCloud as PointCloud
    from isacbench.model.observation import Observation as Observation
    from isacbench.model.scene import Scenario as Scenario
    from isacbench.model.scenes.scenario import load_scenario as load_scenario
    from isacbench.plugins.registry import get_detector as get_detector
    from isacbench.plugins.registry import get_estimator as get_estimator
    from isacbench.plugins.registry import get_metric as get_metric
    from isacbench.plugins.scoring import score as score
    from isacbench.report.clouds import plot_clouds as plot_clouds

__version__ = "0.2.0"

# The public names by their modules: loaded on first use, so that the command line starts without NumPy.
_NAMES = {
    "isacbench.bench.compare.comparison": ["Comparison", "compare"],
    "isacbench.bench.compare.pairs": ["NotComparableError"],
    "isacbench.bench.compare.ranking": ["Ranking", "rank"],
    "isacbench.bench.run.runner": ["run"],
    "isacbench.bench.store.run": ["load_run"],
    "isacbench.checking.plugin_check": ["check"],
    "isacbench.cubes.frame": ["observe_cube"],
    "isacbench.errors": ["InputError"],
    "isacbench.link.sensing.observing": ["observe"],
    "isacbench.model.cloud": ["PointCloud"],
    "isacbench.model.observation": ["Observation"],
    "isacbench.model.scenes.scenario": ["Scenario", "load_scenario"],
    "isacbench.plugins.registry": ["get_detector", "get_estimator", "get_metric"],
    "isacbench.plugins.scoring": ["score"],
    "isacbench.report.clouds": ["plot_clouds"],
}
_MODULES = {name: module for module, names in _NAMES.items() for name in names}

__all__ = sorted([*_MODULES, "__version__"])

keep_to_checkout()


def __getattr__(name: str) -> object:
    """Load a public name on first use (PEP 562)."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value: object = getattr(import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names, loaded or not."""
    return sorted({*globals(), *__all__})
