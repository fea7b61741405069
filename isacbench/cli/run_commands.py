"""The command that runs a suite."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from isacbench.bench.run.progress import progress_shown
from isacbench.cli.app import EXIT_FAILED_CELLS, app, fail
from isacbench.cli.options import (
    OUT_HELP,
    SEED_HELP,
    EstimatorSpecs,
    PluginFiles,
    ScenarioNames,
    register,
    require_names,
)
from isacbench.cli.printing import report_run
from isacbench.cli.termination import Termination
from isacbench.errors import InputError

if TYPE_CHECKING:
    from isacbench.bench.cells.record import Results
    from isacbench.bench.run.runner import Execution
    from isacbench.bench.suites.suite import Suite


@app.command("run")
def run_command(
    suite: Annotated[str, typer.Argument(metavar="[SUITE]", help="Suite by name or .toml path.")] = "paper",
    estimator: EstimatorSpecs = None,
    scenario: ScenarioNames = None,
    snr: Annotated[
        str | None, typer.Option("--snr", metavar="-30:20:5", help="SNRs in dB: a range, a list or one.")
    ] = None,
    trials: Annotated[
        int | None, typer.Option("-n", "--trials", metavar="TRIALS", min=1, help="Noise draws.")
    ] = None,
    seed: Annotated[int | None, typer.Option("--seed", metavar="SEED", min=0, help=SEED_HELP)] = None,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="DIR", help=OUT_HELP),
    ] = None,
    plugin: PluginFiles = None,
    jobs: Annotated[
        int | None,
        typer.Option("-j", "--jobs", metavar="JOBS", min=1, help="Worker processes; default 1."),
    ] = None,
    timeout: Annotated[
        float | None,
        typer.Option(
            "--timeout", metavar="SECONDS", help="Longest time of a cell; default 600, inf for none."
        ),
    ] = None,
    memory: Annotated[
        float | None,
        typer.Option("--memory", metavar="MIB", help="Most memory that a cell may add to its process."),
    ] = None,
    dask: Annotated[
        str | None,
        typer.Option("--dask", metavar="ADDRESS", help="Dask scheduler, instead of workers of this machine."),
    ] = None,
    shard: Annotated[
        str | None,
        typer.Option("--shard", metavar="k/n", help="Only part k of n; isacbench merge joins parts."),
    ] = None,
    rerun: Annotated[
        list[str] | None,
        typer.Option(
            "--rerun", metavar="failed|stale|all", help="Cells of an existing folder to run again; repeats."
        ),
    ] = None,
    mix_versions: Annotated[
        bool, typer.Option("--mix-versions", help="Keep rows that other versions made beside new ones.")
    ] = False,
    timing: Annotated[
        bool, typer.Option("--timing", help="Measure run times that count, one cell after the other.")
    ] = False,
    repeats: Annotated[
        int | None,
        typer.Option("--repeats", metavar="REPEATS", min=1, help="Estimates timed a cell; default 5."),
    ] = None,
) -> None:
    """Run a suite: estimate, score, tabulate and draw; go on with a run where its folder exists."""
    from isacbench.bench.suites.suite import parse_snr
    from isacbench.bench.suites.suite_kinds import load_suite

    if out is None and (rerun or mix_versions):
        raise InputError(
            "--rerun and --mix-versions: allowed with -o DIR, the folder of the run to go on with"
        )
    register(plugin)
    wanted = load_suite(suite).replace(
        estimators=estimator,
        scenarios=scenario,
        snr_db=None if snr is None else parse_snr(snr),
        trials=trials,
        seed=seed,
    )
    require_names(wanted.scenarios, wanted.estimators, getattr(wanted, "detectors", ()))
    if dask is None:
        from isacbench.bench.workers.process_server import start_process_server

        start_process_server()  # which imports what workers need while this process imports the rest
    from isacbench.bench.cells.statuses import failed
    from isacbench.bench.cells.timing import repeats_wanted
    from isacbench.bench.plan.run_plan import Shard
    from isacbench.bench.run.runner import Execution
    from isacbench.bench.store.resume import parse_reruns
    from isacbench.bench.store.run_folder import default_folder
    from isacbench.bench.workers.guarded_cells import DEFAULT_TIMEOUT_S, Guard

    execution = Execution(
        n_jobs=jobs or (1 if dask is None else None),
        guard=Guard(
            timeout_s=DEFAULT_TIMEOUT_S if timeout is None else None if timeout == math.inf else timeout,
            memory_mib=None if memory == math.inf else memory,
        ),
        dask=dask,
        shard=None if shard is None else Shard.parse(shard),
        rerun=parse_reruns(rerun or ()),
        mix_versions=mix_versions,
        repeats=repeats_wanted(timing, repeats),
    )
    folder = default_folder(wanted.name) if out is None else out
    with Termination() as termination:
        try:
            results = _run_and_report(wanted, folder, execution)
        except KeyboardInterrupt:
            termination.fail(_describe_left(folder))
        if results.interrupted:
            termination.fail(f"the {len(results.records)} cells so far are in {folder}")
    lost = results.records[failed(results.records)]
    if not lost.empty:
        first = lost.iloc[0]
        fail(
            f"{len(lost)} of {len(results.records)} cells failed, the first one {first['estimator']} on "
            f"{first['scenario']} at {first['snr_db']:g} dB, trial {first['trial']}: {first['status']}, "
            f"{first['reason']}",
            EXIT_FAILED_CELLS,
        )


def _run_and_report(suite: Suite, folder: Path, execution: Execution) -> Results:
    """Run a suite and make tables and figures of its rows, also of those that an interrupt left."""
    from isacbench.bench.run.runner import run_suite
    from isacbench.report.figures.background_drawing import BackgroundDrawing

    with BackgroundDrawing() as drawing:
        with progress_shown(suite.name, is_idle=execution.is_timing) as show:

            def progress(n_done: int, n_cells: int) -> None:
                if not execution.is_timing:
                    drawing.get_ready()  # as soon as workers are busy, and this process is not
                show(n_done, n_cells)

            results = run_suite(suite, folder, progress, execution)
        if not results.records.empty:
            report_run(folder, results.records, results.suite.kind, drawing)
    return results


def _describe_left(folder: Path) -> str:
    """Describe what an interrupt outside the work on cells leaves."""
    from isacbench.bench.store.run_store import MANIFEST

    if not (folder / MANIFEST).exists():
        return "nothing is done yet"
    return f"what is done so far is in {folder}; isacbench report {folder} tabulates it"
