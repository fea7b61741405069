"""Runs of suites: every estimator images the same observations, one row a cell, kept where a run goes on."""

from __future__ import annotations

import time
from collections.abc import Collection, Generator, Mapping, Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from isacbench.bench.cells.cell import DEFAULT_TIMEOUT_S, Limits
from isacbench.bench.cells.plan import Block, Job, Plan, Shard, load_job
from isacbench.bench.cells.provenance import differing_versions, environment_id
from isacbench.bench.cells.rows import REFERENCE_COLUMNS, TIMING_COLUMNS, Row, failed, typed
from isacbench.bench.cells.worker import rows_guarded, rows_here
from isacbench.bench.labels import estimator_labels
from isacbench.bench.run.progress import Progress, progress_shown
from isacbench.bench.store.manifest import (
    SCORES,
    build_manifest,
    describe_run,
    describe_session,
    require_same_scores,
    row_columns,
    with_sessions,
    write_manifest,
)
from isacbench.bench.store.run import Run, Scenes, write_truth
from isacbench.bench.store.run_folder import JOURNAL, Journal, open_folder
from isacbench.bench.suites.suite import Suite
from isacbench.bench.suites.suite_kinds import load_suite, with_metrics
from isacbench.charts import Variant
from isacbench.checked_arrays import Mask
from isacbench.errors import InputError, unknown_name
from isacbench.plugins.contracts import Estimator, is_reference
from isacbench.plugins.discovery import isolated_plugins, load_plugin_file

Rerun = Literal["failed", "stale", "all"]

DEFAULT_REPEATS = 5
"""The median of five repeats ignores two disturbed ones."""


@dataclass(frozen=True)
class RunOptions:
    """Options of a run that do not change what its cells yield, as `isacbench.run` takes them.

    Attributes
    ----------
    limits : Limits
        Of each cell in a worker.
    part : Shard or None
        Parsed `shard`.

    Raises
    ------
    InputError
        If a value is not allowed.
    """

    jobs: int | None = None
    timeout_s: float | None = DEFAULT_TIMEOUT_S
    memory_mib: float | None = None
    dask: str | None = None
    shard: str | None = None
    rerun: Collection[str] = ()
    mix_versions: bool = False
    timing: bool = False
    repeats: int | None = None
    limits: Limits = field(init=False)
    part: Shard | None = field(init=False)

    def __post_init__(self) -> None:
        for name, value in (("jobs", self.jobs), ("repeats", self.repeats)):
            if value is not None and value < 1:
                raise InputError(f"{name} {value}: allowed is 1 or more")
        if self.jobs is not None and self.dask is not None:
            raise InputError("jobs and dask cannot be given together: give one")
        if self.repeats is not None and not self.timing:
            raise InputError(f"repeats = {self.repeats} needs timing; without it each cell is estimated once")
        if self.timing and (self.dask is not None or (self.jobs or 1) > 1):
            where = "dask" if self.dask else f"jobs {self.jobs}"
            raise InputError(
                f"timing needs one job on this machine, not {where}: cells that run at the same time slow "
                "each other down"
            )
        for name in self.rerun:
            if name not in get_args(Rerun):
                raise unknown_name("cells to rerun", name, get_args(Rerun))
        object.__setattr__(self, "limits", Limits(self.timeout_s, self.memory_mib))
        object.__setattr__(self, "part", None if self.shard is None else Shard.parse(self.shard))
        if not self.is_guarded and self.limits not in (Limits(), Limits(None)):
            raise InputError("timeout_s and memory_mib limit worker processes: give jobs or dask as well")

    @property
    def is_guarded(self) -> bool:
        """True if cells run in worker processes, with limits."""
        return self.jobs is not None or self.dask is not None

    @property
    def n_repeats(self) -> int | None:
        """Timed repeats of each estimate; None for a run that is not timed."""
        return (self.repeats or DEFAULT_REPEATS) if self.timing else None

    def describe(self) -> dict[str, Any]:
        """Describe the options in terms of JSON."""
        return {
            "jobs": self.jobs,
            "timeout_s": self.timeout_s if self.is_guarded else None,
            "memory_mib": self.memory_mib if self.is_guarded else None,
            "dask": self.dask,
            "shard": None if self.part is None else f"{self.part.k}/{self.part.n}",
            "timing": self.timing,
            "repeats": self.n_repeats,
        }


DEFAULTS = RunOptions()


def run(
    suite: str | Path | Suite,
    *,
    estimators: Sequence[str | Estimator] | None = None,
    plugins: Sequence[str | Path] = (),
    metrics: Sequence[str] = (),
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
    progress: bool = False,
) -> pd.DataFrame:
    """Run a suite and return its records.

    Parameters
    ----------
    suite : str, Path or Suite
        Name of a built-in suite, path of a TOML file, or a suite.
    estimators : sequence of str or Estimator, optional
        Replace those of the suite: specifications such as
        ``music2d[pfa=1e-4]``, and your own estimators, instances of frozen
        dataclasses. Classes of a script or a notebook are sent to workers by
        their code; those of a module must be importable there.
    plugins : sequence of str or Path
        Python files whose plugins are registered for this run.
    metrics : sequence of str
        Further metrics of every image, as ``name[param=value,...]``.
    scenarios, snr_db, trials, seed : optional
        Replace those of the suite; `snr_db` replaces `snr_gain_db`, too.
    out : str or Path, optional
        Folder for the results. If it holds a part of this run already, only
        the rest is run. Without it nothing is kept.
    jobs : int, optional
        Worker processes. If a cell hangs, exhausts memory or crashes in one,
        only its own row fails. Without it cells run in this process,
        unguarded.
    timeout_s, memory_mib : float or None
        Most wall time in s and memory in MiB of a cell in a worker; None for
        no limit.
    dask : str, optional
        Address of a Dask scheduler whose workers run the cells.
    shard : str, optional
        ``k/n``: part k of n of the cells, for job arrays.
    rerun : collection of {"failed", "stale", "all"}
        Cells in `out` to run again.
    mix_versions : bool
        True to keep rows of other versions in `out` beside new ones.
    timing : bool
        True to time each estimate several times, with nothing else running;
        rows of `out` that were not timed are made again.
    repeats : int, optional
        Timed repeats of each estimate, with `timing`; 5 by default.
    progress : bool
        True to show progress: as a bar on a terminal, or as a line a minute on stderr.

    Returns
    -------
    DataFrame
        One row for each scenario, SNR, trial and estimator. Columns are those
        of `isacbench.bench.cells.rows.COLUMNS` and those of the kind of
        suite.

    Raises
    ------
    InputError
        If a name, a parameter or a value is not allowed, or the run does not
        belong to the one in `out`.
    KeyboardInterrupt
        If the run was interrupted. With `out` the rows so far are written first.

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
    options = RunOptions(
        jobs=jobs,
        timeout_s=timeout_s,
        memory_mib=memory_mib,
        dask=dask,
        shard=shard,
        rerun=rerun,
        mix_versions=mix_versions,
        timing=timing,
        repeats=repeats,
    )
    wanted = with_metrics(wanted, metrics)
    if estimators is not None:
        wanted = wanted.with_estimators(estimators)
    with (
        isolated_plugins(),
        progress_shown(wanted.name, is_idle=timing) if progress else nullcontext() as show,
    ):
        for path in plugins:
            load_plugin_file(path)
        results = run_suite(wanted, None if out is None else Path(out), show, options)
    if results.manifest["interrupted"]:
        raise KeyboardInterrupt(
            f"after {len(results.rows)} cells" + (f", written to {out}" if out is not None else "")
        )
    return results.rows


def run_suite(
    suite: Suite,
    out: Path | None = None,
    progress: Progress | None = None,
    options: RunOptions = DEFAULTS,
) -> Run:
    """Run a suite into a folder, new or of the same run. An interrupt ends it early and keeps its rows.

    Without a folder the run is in memory alone. `progress` is called after each cell with the numbers of
    cells done and of all. InputError if the suite names something unknown, or does not belong to the run in
    `out`.
    """
    job = load_job(suite)
    started, tick = datetime.now().astimezone(), time.perf_counter()
    called = {**options.describe(), "plugins": {one.filename: one.path for one in job.plugins}}
    plan = job.plan
    wanted = np.ones(plan.n_cells, dtype=np.bool_) if options.part is None else plan.shard(options.part)
    with open_folder(out) as folder:
        stored = Run.recover(folder)
        try:
            kept = rows_to_keep(stored, job, options, wanted)
        except InputError as error:
            raise InputError(f"{stored.label}: {error}") from error
        todo = wanted.copy()
        todo[plan.positions(kept.rows)] = False
        earlier, described = stored.manifest.get("sessions", []), describe_run(job)
        columns = row_columns(suite, described[SCORES]["columns"])
        with closing(_work(job, plan.blocks(todo), options)) as rows:
            sessions = [*earlier, describe_session(started, 0.0, True, called)]
            manifest = build_manifest(described, kept.environments, sessions)
            # The rows of an earlier call are in the tables before its journal is removed, so that a kill at
            # any moment loses none.
            path = folder / JOURNAL
            if len(kept.rows) < len(stored.rows) or (path.exists() and len(kept.rows)):
                kept.changed(rows=typed(kept.rows, columns)).save_rows(folder)
            write_truth(folder, job.scenarios)
            write_manifest(folder, manifest)
            path.unlink(missing_ok=True)
            has_reference = any(is_reference(one.plugin) for one in plan.entries)
            further = {
                **columns,
                **(TIMING_COLUMNS if options.timing else {}),
                **(REFERENCE_COLUMNS if has_reference else {}),
            }
            interrupted, n_done = False, int(np.sum(wanted & ~todo))
            with closing(Journal(path, further)) as journal:
                try:
                    for n, row in enumerate(rows, start=n_done + 1):
                        journal.append(row)
                        if progress is not None:
                            progress(n, int(wanted.sum()))
                except KeyboardInterrupt:
                    interrupted = True
        found = Run.joined([kept, Run.of_journal(path)])
        found = found.take(np.argsort(plan.positions(found.rows), kind="stable"))
        clouds, wall_time_s = found.points, time.perf_counter() - tick
        sessions = [*earlier, describe_session(started, wall_time_s, interrupted, called)]
        names, known = found.rows["environment"].unique(), found.environments
        used = {name: known[name] for name in names if name in known}
        run = Run(
            str(folder),
            typed(found.rows, columns),
            with_sessions(manifest, used, sessions),
            read_clouds=lambda: clouds,
            read_scenes=lambda: Scenes(suite, job.scenarios, job.draws()),
        )
        if out is not None:
            run.save(folder)
    return run


def _work(job: Job, blocks: Sequence[Block], options: RunOptions) -> Generator[Row, None, None]:
    """Rows of blocks from this process, from workers or from a cluster, which is connected at once."""
    if options.dask is not None and blocks:
        try:
            from isacbench.bench.cells.cluster import rows_on_cluster
        except ImportError as error:  # an optional dependency
            raise InputError(
                "dask: the package `distributed` is missing; pip install 'isacbench[distributed]', here and "
                "where workers run"
            ) from error
        return rows_on_cluster(job, blocks, options.limits, options.dask, options.mix_versions)
    if options.jobs is None:
        return rows_here(job, blocks, options.n_repeats)
    return rows_guarded(job, blocks, options.limits, options.jobs, options.n_repeats)


def rows_to_keep(stored: Run, job: Job, options: RunOptions, part: Mask) -> Run:
    """Select the stored rows that a resumed run keeps, at most one a cell; refuse to lose any others.

    Not kept are rows to be made again (of failed cells, of cells whose scenario or versions have changed
    since, or all) within `part`, the cells that this run computes, and of a timed run those that were not
    timed. Rows of another suite, seed or grid are refused, those scored by other metrics, and those of other
    scenarios or, unless they may be mixed, other versions that are neither kept nor computed again.
    """
    rows, plan = stored.rows, job.plan
    if rows.empty:
        return stored
    is_all_again = "all" in options.rerun and part.all()
    if SCORES in stored.manifest or not is_all_again:  # without them it is not known what scored the rows
        require_same_scores(stored.manifest, job.suite)
    positions = plan.positions(rows)
    _refuse_others(rows, positions, plan, job.suite)
    known = plan.environments.values()  # the manifest may be damaged
    environments = {**stored.environments, **{environment_id(one): one for one in known}}
    now = plan.versions()
    contents = {task.name: task.content for task in plan.tasks}
    other_content: Mask = (rows["scenario_content"] != rows["scenario"].map(contents)).to_numpy()
    other_versions = _other_versions(rows, environments, now) & (not options.mix_versions)
    again = np.full(len(rows), "all" in options.rerun)
    if options.timing:
        again |= ~rows["timing"].to_numpy(dtype=np.bool_)
    if "failed" in options.rerun:
        again |= failed(rows).to_numpy()
    if "stale" in options.rerun:
        again |= other_content | other_versions
    again &= part[positions]
    is_last = ~pd.Series(positions).duplicated(keep="last").to_numpy()
    good = is_last & ~stored.lost_clouds() & ~again
    if (stale := good & other_content).any():
        raise InputError(
            f"{stale.sum()} of its {stale.size} cells were made with different content of scenario "
            f"{rows[stale].iloc[0]['scenario']!r}: use --rerun stale (without --shard), or a new folder"
        )
    if (stale := good & other_versions).any():
        first = rows[stale].iloc[0]
        old = environments.get(first["environment"], {}).get("versions", {})
        new = now[first["estimator"], first["params"]]
        raise InputError(
            f"{stale.sum()} of its {stale.size} cells were made by other versions, the first one by "
            f"{', '.join(differing_versions(old, new))}; use --rerun stale (without --shard) to "
            "recompute them, --mix-versions to keep them, or a new folder"
        )
    return stored.changed(manifest={**stored.manifest, "environments": environments}).take(good)


def _refuse_others(rows: pd.DataFrame, positions: NDArray[np.int64], plan: Plan, suite: Suite) -> None:
    """Refuse rows of cells that are not in the plan."""
    for column, wanted in (("suite", suite.name), ("seed", suite.seed)):
        others = rows.loc[rows[column] != wanted, column]
        if len(others):
            raise InputError(
                f"it holds cells of {column} {others.iloc[0]}, not {wanted}; "
                f"use the same {column}, or a new folder"
            )
    unknown = rows[positions < 0]
    if len(unknown):
        first = unknown.iloc[0]
        variant = first["estimator"], first["params"]
        labels = estimator_labels([variant, *(one.key for one in plan.entries)])
        raise InputError(
            f"it holds {len(unknown)} cells that this run does not have, the first one "
            f"{labels[variant]} on {first['scenario']} at {first['snr_db']:g} dB, trial {first['trial']}; "
            "include them in this run, or use a new folder"
        )


def _other_versions(rows: pd.DataFrame, environments: Mapping[str, Any], now: Mapping[Variant, Any]) -> Mask:
    """Tell which rows were made by other versions than rows of this process would be."""
    groups = rows.groupby(["environment", "estimator", "params"], sort=False)
    other = [
        environments.get(name, {}).get("versions") != now[estimator, params]
        for name, estimator, params in groups.size().index
    ]
    return np.array(other, dtype=np.bool_)[groups.ngroup().to_numpy()]
