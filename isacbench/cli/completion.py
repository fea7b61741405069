"""Completion of names on the command line."""

from __future__ import annotations


def estimators_like(incomplete: str) -> list[str]:
    """List the registered estimators whose names begin with a text."""
    from isacbench.plugins.registry import estimator_names

    return _like(estimator_names(), incomplete)


def plugin_metrics_like(incomplete: str) -> list[str]:
    """List the registered metrics whose names begin with a text."""
    from isacbench.plugins.registry import metric_names

    return _like(metric_names(), incomplete)


def scenarios_like(incomplete: str) -> list[str]:
    """List the scenarios and families whose names begin with a text.

    Returns
    -------
    list of str
        Families end with ``[seed=``.
    """
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
