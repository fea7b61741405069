"""The runner: every estimator on the same observations, timed, scored, one record a cell."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from threadpoolctl import threadpool_limits

from isacbench.bench.record import Cell, Outcome, Record, Results, tabulate
from isacbench.bench.store import reserve_folder, write_results
from isacbench.bench.suite import Suite, load_suite
from isacbench.errors import InputError
from isacbench.metrics.score import score
from isacbench.model.cloud import PointCloud
from isacbench.model.echo import Simulator
from isacbench.model.scenario import Scenario, load_scenario
from isacbench.registry import AnyEstimator, build_estimator, canonical_params

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import ArrayLike

    from isacbench.contracts import Estimator, TruthEstimator
    from isacbench.model.observation import Observation

__all__ = ["Progress", "estimate_cloud", "run", "run_cell", "run_suite"]

Progress = Callable[[int, int], None]
"""Called after each cell with the number of cells done and the number of all."""


def run(
    suite: str | Path | Suite,
    *,
    estimators: Sequence[str] | None = None,
    scenarios: Sequence[str | Path] | None = None,
    snr_db: ArrayLike | None = None,
    trials: int | None = None,
    seed: int | None = None,
    out: str | Path | None = None,
) -> pd.DataFrame:
    """Run a suite and return its records.

    Parameters
    ----------
    suite : str, Path or Suite
        Name of a built-in suite, path of a TOML file, or a suite.
    estimators, scenarios, snr_db, trials, seed : optional
        Replace the suite's own.
    out : str or Path, optional
        New folder for the results; without it nothing is written.

    Returns
    -------
    DataFrame
        One row for each scenario, SNR, trial and estimator; the columns are
        the fields of `isacbench.bench.record.Record`.

    Raises
    ------
    InputError
        If a name, a parameter or a value is not allowed, or `out` exists.
    KeyboardInterrupt
        If the run was interrupted; with `out` the rows so far are written first.

    Examples
    --------
    >>> records = run("quick", estimators=["oracle"], snr_db=[10], trials=1)
    >>> records.status.tolist()
    ['ok']
    """
    base = suite if isinstance(suite, Suite) else load_suite(suite)
    results = run_suite(
        base.replace(
            estimators=estimators,
            scenarios=None if scenarios is None else [str(scenario) for scenario in scenarios],
            snr_db=None if snr_db is None else np.atleast_1d(snr_db).tolist(),
            trials=trials,
            seed=seed,
        ),
        out=None if out is None else Path(out),
    )
    if results.interrupted:
        raise KeyboardInterrupt(
            f"after {len(results.records)} cells" + (f", written to {out}" if out is not None else "")
        )
    return results.records


def run_suite(suite: Suite, out: Path | None = None, progress: Progress | None = None) -> Results:
    """Run a suite; an interrupt ends it early and keeps the records so far.

    Parameters
    ----------
    suite : Suite
    out : Path, optional
        New folder for the results; without it nothing is written.
    progress : callable, optional
        Called after each cell with the numbers of cells done and of all.

    Returns
    -------
    Results

    Raises
    ------
    InputError
        If the suite names something unknown, or `out` exists.
    """
    started, tick = datetime.now().astimezone(), time.perf_counter()
    estimators = _build_estimators(suite)
    scenarios = _load_scenarios(suite)
    n_cells = len(scenarios) * len(suite.snr_db) * suite.trials * len(estimators)
    outcomes: list[Outcome] = []
    interrupted = False
    with reserve_folder(out) if out is not None else nullcontext():
        try:
            # Threads make small batched algebra slower and its timing unrepeatable.
            with threadpool_limits(limits=1):
                for outcome in _outcomes(suite, scenarios, estimators):
                    outcomes.append(outcome)
                    if progress is not None:
                        progress(len(outcomes), n_cells)
        except KeyboardInterrupt:
            interrupted = True
        records, clouds = tabulate(outcomes)
        wall_time_s = time.perf_counter() - tick
        results = Results(suite, records, clouds, scenarios, started, wall_time_s, interrupted)
        if out is not None:
            write_results(results, out)
    return results


def run_cell(cell: Cell, scenario: Scenario, observation: Observation, estimator: AnyEstimator) -> Outcome:
    """Estimate, time and score one cell; whatever the estimator raises becomes the record's reason.

    Parameters
    ----------
    cell : Cell
        The key of the row.
    scenario : Scenario
        Whose truth the estimate is scored against.
    observation : Observation
    estimator : Estimator or TruthEstimator

    Returns
    -------
    Outcome
    """
    truth = scenario.truth
    start = time.perf_counter()
    try:
        cloud = estimate_cloud(estimator, observation, truth)
        estimated = time.perf_counter()
        scores: dict[str, Any] = dict(
            score(truth, cloud, region=scenario.region, velocity_bin_mps=scenario.system.velocity_bin_mps)
        )
    except Exception as error:
        record = Record(
            **vars(cell),
            status="error",
            reason=f"{type(error).__name__}: {error}",
            n_true=len(truth),
            n_estimated=0,
            time_estimate_s=time.perf_counter() - start,
        )
        return Outcome(record, PointCloud.empty())
    record = Record(
        **vars(cell),
        status="ok" if len(cloud) else "no_detection",
        reason="",
        **scores,
        time_estimate_s=estimated - start,
        time_score_s=time.perf_counter() - estimated,
    )
    return Outcome(record, cloud)


def estimate_cloud(estimator: AnyEstimator, observation: Observation, truth: PointCloud) -> PointCloud:
    """Image an observation; the truth goes to an estimator that declares its need of it, and to no other.

    Raises
    ------
    TypeError
        If the estimator returns anything but a `PointCloud`.
    """
    if getattr(estimator, "needs_truth", False):
        cloud = cast("TruthEstimator", estimator).estimate(observation, truth)
    else:
        cloud = cast("Estimator", estimator).estimate(observation)
    if not isinstance(cloud, PointCloud):
        raise TypeError(f"estimate() must return a PointCloud, not {type(cloud).__name__}")
    return cloud


def _outcomes(
    suite: Suite, scenarios: dict[str, Scenario], estimators: dict[tuple[str, str], AnyEstimator]
) -> Iterator[Outcome]:
    """Outcomes cell by cell, in the order in which echo, noise and observation are shared best."""
    for scenario in scenarios.values():
        simulator = Simulator(scenario)
        for trial in range(suite.trials):
            for snr_db in suite.snr_db:
                observation = simulator.observe(snr_db, trial, suite.seed)
                for (name, params), estimator in estimators.items():
                    cell = Cell(suite.name, scenario.name, name, params, snr_db, trial, suite.seed)
                    yield run_cell(cell, scenario, observation, estimator)


def _build_estimators(suite: Suite) -> dict[tuple[str, str], AnyEstimator]:
    """Estimators of a suite by name and canonical parameters."""
    built: dict[tuple[str, str], AnyEstimator] = {}
    for spec in suite.estimators:
        estimator = build_estimator(spec)
        key = estimator.name, canonical_params(estimator)
        if key in built:
            raise InputError(f"estimators: {spec!r} repeats an estimator with equal parameters")
        built[key] = estimator
    return built


def _load_scenarios(suite: Suite) -> dict[str, Scenario]:
    """Scenarios of a suite by name."""
    loaded: dict[str, Scenario] = {}
    for name_or_path in suite.scenarios:
        scenario = load_scenario(name_or_path)
        if scenario.name in loaded:
            raise InputError(f"scenarios: {name_or_path!r} repeats the name {scenario.name!r}")
        if not len(scenario.scatterers):
            raise InputError(f"scenarios: {name_or_path!r} has no scatterers, so that nothing can be scored")
        loaded[scenario.name] = scenario
    return loaded
