"""The runner: every estimator on the same observations, timed, scored, one record a cell."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from isacbench.bench.cell import estimate_cloud, run_cell
from isacbench.bench.record import DRAW_COLUMNS, Outcome, Results, tabulate
from isacbench.bench.store import reserve_folder, write_results
from isacbench.bench.studies import STUDIES
from isacbench.bench.suite import Suite, load_suite
from isacbench.errors import InputError
from isacbench.model.scenario import Scenario, load_scenario

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from isacbench.bench.study import Scene

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
        Replace the suite's own; `snr_db` also takes the place of `snr_gain_db`.
    out : str or Path, optional
        New folder for the results; without it nothing is written.

    Returns
    -------
    DataFrame
        One row for each scenario, SNR, trial and estimator; the columns are
        the fields of `isacbench.bench.record.Record` and those that the
        suite's kind adds.

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
    scenarios = _load_scenarios(suite)
    scenes = _expand(suite, scenarios)
    n_cells = sum(len(scene.snr_db) * scene.n_contestants for scene in scenes) * suite.trials
    outcomes: list[Outcome] = []
    interrupted = False
    with reserve_folder(out) if out is not None else nullcontext():
        try:
            # Threads make small batched algebra slower and its timing unrepeatable.
            with threadpool_limits(limits=1):
                for outcome in _outcomes(suite, scenes):
                    outcomes.append(outcome)
                    if progress is not None:
                        progress(len(outcomes), n_cells)
        except KeyboardInterrupt:
            interrupted = True
        records, clouds = tabulate(outcomes, STUDIES[suite.kind].columns)
        draws = _draws(scenes, suite.trials)
        wall_time_s = time.perf_counter() - tick
        results = Results(suite, records, clouds, scenarios, draws, started, wall_time_s, interrupted)
        if out is not None:
            write_results(results, out)
    return results


def _draws(scenes: Sequence[Scene], n_trials: int) -> pd.DataFrame:
    """Scatterers that the scenes drew."""
    tables = [table for scene in scenes if len(table := scene.draws(n_trials))]
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame(columns=DRAW_COLUMNS)


def _load_scenarios(suite: Suite) -> dict[str, Scenario]:
    """Scenarios of a suite by name."""
    loaded: dict[str, Scenario] = {}
    for name_or_path in suite.scenarios:
        scenario = load_scenario(name_or_path)
        if scenario.name in loaded:
            raise InputError(f"scenarios: {name_or_path!r} repeats the name {scenario.name!r}")
        loaded[scenario.name] = scenario
    return loaded


def _expand(suite: Suite, scenarios: dict[str, Scenario]) -> Sequence[Scene]:
    """Scenes that the suite's study makes of its scenarios."""
    scenes = STUDIES[suite.kind].scenes(suite, scenarios)
    names = [scene.name for scene in scenes]
    for index, name in enumerate(names):
        if name in names[:index]:
            raise InputError(f"scenarios: two scenes have the name {name!r}; rename a scenario")
    return scenes


def _outcomes(suite: Suite, scenes: Sequence[Scene]) -> Iterator[Outcome]:
    """Outcomes cell by cell, in the order in which echo, noise and observation are shared best."""
    for scene in scenes:
        for trial in range(suite.trials):
            for snr_db in scene.snr_db:
                yield from scene.outcomes(snr_db, trial)
