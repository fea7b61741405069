"""The runner: every estimator on the same observations, timed, scored, one record a cell."""

from __future__ import annotations

import time
from collections.abc import Collection, Generator, Iterable, Mapping, Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from isacbench.bench.cells.record import TIMING_COLUMNS, Results, typed
from isacbench.bench.cells.timing import repeats_wanted
from isacbench.bench.plan.job import load_job
from isacbench.bench.plan.run_plan import Shard
from isacbench.bench.run.progress import Progress, notebook_display, progress_shown
from isacbench.bench.store.journal import Journal, read_journal
from isacbench.bench.store.resume import Rerun, keep, parse_reruns
from isacbench.bench.store.rows import Rows
from isacbench.bench.store.run_folder import open_folder
from isacbench.bench.store.run_store import (
    JOURNAL,
    Session,
    describe_run,
    read_rows,
    read_sessions,
    require_metric,
    write_manifest,
    write_results,
    write_rows,
    write_truth,
)
from isacbench.bench.suites.suite import Suite
from isacbench.bench.suites.suite_kinds import kind_of, load_suite
from isacbench.bench.workers.guarded_cells import DEFAULT_TIMEOUT_S, Guard
from isacbench.bench.workers.local_workers import work_alone, work_guarded, work_here
from isacbench.errors import InputError
from isacbench.plugins.discovery import isolated_plugins, load_plugin_file

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from isacbench.bench.plan.job import Job
    from isacbench.bench.plan.run_plan import Block, Plan
    from isacbench.bench.store.provenance import Made
    from isacbench.plugins.contracts import Estimator


@dataclass(frozen=True)
class Execution:
    """Where and how cells are worked off, none of which changes what they yield.

    Attributes
    ----------
    n_jobs : int or None
        Guarded worker processes on this machine; None for this process,
        without guard.
    guard : Guard
        Limits of every cell, where there are workers.
    dask : str or None
        Address of a Dask scheduler, whose workers take the place of those
        of this machine.
    shard : Shard or None
        Which part of the cells.
    rerun : collection of {"failed", "stale", "all"}
        Stored cells that are made again.
    mix_versions : bool
        Whether rows of other versions may stay beside new ones.
    repeats : int or None
        How often each estimate is timed, alone and one after the other; None
        where times do not count.

    Raises
    ------
    InputError
        If a value is not allowed.
    """

    n_jobs: int | None = None
    guard: Guard = field(default_factory=Guard)
    dask: str | None = None
    shard: Shard | None = None
    rerun: Collection[Rerun] = ()
    mix_versions: bool = False
    repeats: int | None = None

    def __post_init__(self) -> None:
        if self.n_jobs is not None and self.n_jobs < 1:
            raise InputError(f"jobs {self.n_jobs}: allowed is 1 or more")
        if self.n_jobs is not None and self.dask is not None:
            raise InputError(
                "jobs and dask: allowed is one of them; how many jobs a Dask worker runs is its own matter"
            )
        if self.repeats is not None and self.repeats < 1:
            raise InputError(f"repeats {self.repeats}: allowed is 1 or more")
        if self.is_timing and (self.n_jobs or 1) > 1:
            raise InputError(
                f"jobs {self.n_jobs} and timing: allowed is one job, for cells side by side share memory and "
                "clock rate, and none of their times would count"
            )
        if self.is_timing and self.dask is not None:
            raise InputError(
                "dask and timing: allowed are cells on this machine, one after the other, for nobody knows "
                "what else the workers of a cluster do"
            )
        if not self.is_guarded and self.guard not in (Guard(), Guard(None)):
            raise InputError(
                "timeout_s and memory_mib: allowed are they with jobs or dask, for workers alone have limits"
            )

    @property
    def is_guarded(self) -> bool:
        """Whether cells have processes of their own, and limits."""
        return self.n_jobs is not None or self.dask is not None

    @property
    def is_timing(self) -> bool:
        """Whether times count."""
        return self.repeats is not None

    def describe(self) -> dict[str, Any]:
        """Describe it in terms of JSON."""
        return {
            "jobs": self.n_jobs,
            "timeout_s": self.guard.timeout_s if self.is_guarded else None,
            "memory_mib": self.guard.memory_mib if self.is_guarded else None,
            "dask": self.dask,
            "shard": None if self.shard is None else f"{self.shard.k}/{self.shard.n}",
            "timing": self.is_timing,
            "repeats": self.repeats,
        }


HERE = Execution()


def run(
    suite: str | Path | Suite,
    *,
    estimators: Sequence[str | Estimator] | None = None,
    plugins: Sequence[str | Path] = (),
    scenarios: Sequence[str | Path] | None = None,
    snr_db: ArrayLike | None = None,
    trials: int | None = None,
    seed: int | None = None,
    out: str | Path | None = None,
    jobs: int | None = None,
    timeout_s: float | None = DEFAULT_TIMEOUT_S,
    memory_mib: float | None = None,
    dask: str | None = None,
    shard: str | None = None,
    rerun: Collection[str] = (),
    mix_versions: bool = False,
    timing: bool = False,
    repeats: int | None = None,
    progress: bool | None = None,
) -> pd.DataFrame:
    """Run a suite and return its records.

    Parameters
    ----------
    suite : str, Path or Suite
        Name of a built-in suite, path of a TOML file, or a suite.
    estimators : sequence of str or Estimator, optional
        In place of the suite's own: specifications such as
        ``music2d[pfa=1e-4]``, and estimators of your own, instances of frozen
        dataclasses. Classes of a script or a notebook are sent to workers by
        their code; those of a module have to be importable there.
    plugins : sequence of str or Path
        Python files whose estimators and detectors have names in this run.
    scenarios, snr_db, trials, seed : optional
        Replace the suite's own; `snr_db` also takes the place of `snr_gain_db`.
    out : str or Path, optional
        Folder for the results. If it holds a part of this run already, only
        the rest is run. Without it nothing is kept.
    jobs : int, optional
        Worker processes, in which a cell that hangs, exhausts memory or
        crashes costs nothing but its own row. Without it cells run in this
        process, unguarded.
    timeout_s, memory_mib : float or None
        Wall time and memory that a cell may take in a worker; None for no
        limit.
    dask : str, optional
        Address of a Dask scheduler whose workers run the cells.
    shard : str, optional
        ``k/n``: part k of n of the cells, for job arrays.
    rerun : collection of {"failed", "stale", "all"}
        Cells in `out` to run again.
    mix_versions : bool
        Whether rows of other versions may stay in `out` beside new ones.
    timing : bool
        Whether times count: each estimate is timed several times, nothing
        runs beside it, and rows of `out` that were not timed are made again.
    repeats : int, optional
        How often, with `timing`; 5 by default.
    progress : bool, optional
        Whether to show how far the run has come: below the cell of a
        notebook, as a bar on a terminal, or as a line a minute on stderr.
        By default in a notebook alone.

    Returns
    -------
    DataFrame
        One row for each scenario, SNR, trial and estimator; the columns are
        those of `isacbench.bench.cells.record.COLUMNS` and those that the suite's
        kind adds.

    Raises
    ------
    InputError
        If a name, a parameter or a value is not allowed, or `out` cannot be
        gone on with.
    KeyboardInterrupt
        If the run was interrupted; with `out` the rows so far are written first.

    Examples
    --------
    >>> records = run("quick", estimators=["oracle"], snr_db=[10], trials=1)
    >>> records.status.tolist()
    ['ok']
    """
    wanted = (suite if isinstance(suite, Suite) else load_suite(suite)).replace(
        scenarios=None if scenarios is None else [str(scenario) for scenario in scenarios],
        snr_db=None if snr_db is None else np.atleast_1d(snr_db).tolist(),
        trials=trials,
        seed=seed,
    )
    execution = Execution(
        n_jobs=jobs,
        guard=Guard(timeout_s, memory_mib),
        dask=dask,
        shard=None if shard is None else Shard.parse(shard),
        rerun=parse_reruns(rerun),
        mix_versions=mix_versions,
        repeats=repeats_wanted(timing, repeats),
    )
    if estimators is not None:
        wanted = wanted.with_estimators(estimators)
    is_shown = notebook_display() is not None if progress is None else progress
    with (
        isolated_plugins(),
        progress_shown(wanted.name, is_idle=timing) if is_shown else nullcontext() as show,
    ):
        for path in plugins:
            load_plugin_file(path)
        results = run_suite(wanted, None if out is None else Path(out), show, execution)
    if results.interrupted:
        raise KeyboardInterrupt(
            f"after {len(results.records)} cells" + (f", written to {out}" if out is not None else "")
        )
    return results.records


def run_suite(
    suite: Suite,
    out: Path | None = None,
    progress: Progress | None = None,
    execution: Execution = HERE,
) -> Results:
    """Run a suite; an interrupt ends it early and keeps the records so far.

    Parameters
    ----------
    suite : Suite
    out : Path, optional
        Folder for the results, new or of the same run; without it nothing is
        kept.
    progress : callable, optional
        Called after each cell with the numbers of cells done and of all.
    execution : Execution, optional
        Where and how cells are worked off.

    Returns
    -------
    Results

    Raises
    ------
    InputError
        If the suite names something unknown, or `out` cannot be gone on with.
    """
    job = load_job(suite)
    plan = job.plan
    session, tick = Session(datetime.now().astimezone(), execution.describe()), time.perf_counter()
    with open_folder(out) as folder:
        sessions, (stored, kept) = read_sessions(folder), _kept(folder, job, execution)
        blocks, n_kept = _blocks_left(plan, kept, execution.shard)
        with closing(_made(job, blocks, execution)) as outcomes:
            unfinished = [*sessions, session.describe(0.0, interrupted=True)]
            _begin(folder, job, kept, unfinished, is_less=len(kept) < len(stored))
            with Journal(folder / JOURNAL, _columns(suite, execution)) as journal:
                interrupted = _work(outcomes, blocks, journal, n_kept, progress)
        new, _ = read_journal(folder / JOURNAL)
        rows = Rows.joined([kept, new])
        rows = rows.take(np.argsort(plan.positions(rows.records), kind="stable"))
        wall_time_s = time.perf_counter() - tick
        results = Results(
            suite=suite,
            records=typed(rows.records, kind_of(suite).columns),
            clouds=rows.clouds(),
            scenarios=dict(job.scenarios),
            draws=job.draws(),
            environments=rows.used_environments(),
            started=session.started,
            wall_time_s=wall_time_s,
            interrupted=interrupted,
        )
        if out is not None:
            _finish(folder, job, results, [*sessions, session.describe(wall_time_s, interrupted)])
    return results


def _kept(folder: Path, job: Job, execution: Execution) -> tuple[Rows, Rows]:
    """Rows that are stored, and those of them that the run goes on with."""
    stored, suite = read_rows(folder), job.suite
    part = None if execution.shard is None else job.plan.shard(execution.shard)
    try:
        if len(stored):
            require_metric(folder)
        kept = keep(
            stored,
            job.plan,
            suite.name,
            suite.seed,
            execution.rerun,
            execution.mix_versions,
            part,
            execution.is_timing,
        )
    except InputError as error:
        raise InputError(f"{folder}: {error}") from error
    return stored, kept


def _columns(suite: Suite, execution: Execution) -> Mapping[str, Any]:
    """Columns that rows have beside those of every table, each with the value of a failure."""
    return {**kind_of(suite).columns, **(TIMING_COLUMNS if execution.is_timing else {})}


def _blocks_left(plan: Plan, kept: Rows, shard: Shard | None) -> tuple[list[Block], int]:
    """Blocks that are still to be worked off, and the number of cells that are not."""
    wanted = np.ones(plan.n_cells, dtype=np.bool_) if shard is None else plan.shard(shard)
    todo = wanted.copy()
    todo[plan.positions(kept.records)] = False
    return plan.blocks(todo), int(np.sum(wanted & ~todo))


def _begin(folder: Path, job: Job, kept: Rows, sessions: list[dict[str, Any]], is_less: bool) -> None:
    """Leave in the folder what the run goes on with, and what it cannot be understood without.

    The journal of an earlier call goes last: what it holds is in the tables
    and in the manifest by then, whatever ends this.
    """
    journal = folder / JOURNAL
    if is_less or (journal.exists() and len(kept)):
        write_rows(folder, typed(kept.records, kind_of(job.suite).columns), kept.clouds())
    write_truth(folder, job.scenarios)
    write_manifest(folder, describe_run(job), kept.environments, sessions)
    journal.unlink(missing_ok=True)


def _work(
    outcomes: Iterable[Made],
    blocks: Sequence[Block],
    journal: Journal,
    n_kept: int,
    progress: Progress | None,
) -> bool:
    """Put every outcome of blocks into the journal at once; whether an interrupt ended it early."""
    n_cells = n_kept + sum(len(block.entries) for block in blocks)
    try:
        for n_done, made in enumerate(outcomes, start=n_kept + 1):
            journal.append(made)
            if progress is not None:
                progress(n_done, n_cells)
    except KeyboardInterrupt:
        return True
    return False


def _made(job: Job, blocks: Sequence[Block], execution: Execution) -> Generator[Made, None, None]:
    """Outcomes of blocks, wherever they are worked off; a cluster that is not there is told at once."""
    if execution.dask is not None:
        from isacbench.bench.workers.cluster import work_on_cluster  # an optional dependency

        return work_on_cluster(job, blocks, execution.guard, execution.dask, execution.mix_versions)
    if execution.n_jobs is None:
        return work_here(job, blocks, execution.repeats)
    if execution.repeats is not None:
        return work_alone(job, blocks, execution.guard, execution.repeats)
    return work_guarded(job, blocks, execution.guard, execution.n_jobs)


def _finish(folder: Path, job: Job, results: Results, sessions: list[dict[str, Any]]) -> None:
    """Write the tables, and only then let go of the journal that they are made from."""
    write_results(results, folder)
    write_manifest(folder, describe_run(job), results.environments, sessions)
    (folder / JOURNAL).unlink()
