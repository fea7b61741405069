"""The command that runs a suite."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from isacbench.bench.run.progress import progress_shown
from isacbench.cli.app import EXIT_FAILED_CELLS, app, fail, say
from isacbench.cli.options import (
    OUT_HELP,
    SEED_HELP,
    EstimatorSpecs,
    Html,
    MetricSpecs,
    MixVersions,
    PluginFiles,
    ScenarioNames,
    SuiteName,
    register,
    require_names,
)
from isacbench.cli.printing import report_run
from isacbench.cli.termination import Termination
from isacbench.errors import InputError

if TYPE_CHECKING:
    from isacbench.bench.run.runner import Execution
    from isacbench.bench.store.run import Run
    from isacbench.bench.suites.suite import Suite


@app.command("run")
def run_command(
    suite: SuiteName = "paper",
    estimator: EstimatorSpecs = None,
    scenario: ScenarioNames = None,
    snr: Annotated[str | None, Option(metavar="-30:20:5", help="SNRs in dB: a range, a list or one.")] = None,
    trials: Annotated[int | None, Option("-n", "--trials", min=1, help="Number of noise draws.")] = None,
    seed: Annotated[int | None, Option(min=0, help=SEED_HELP)] = None,
    out: Annotated[Path | None, Option("-o", "--out", metavar="DIR", help=OUT_HELP)] = None,
    plugin: PluginFiles = None,
    metric: MetricSpecs = None,
    block: Annotated[int, Option(help="Take the k-th next block of seeds of a population.")] = 0,
    jobs: Annotated[int | None, Option("-j", "--jobs", min=1, help="Worker processes; default 1.")] = None,
    timeout: Annotated[float, Option(help="Longest time of a cell in seconds, or inf.")] = 600.0,
    memory: Annotated[float | None, Option(help="Most memory in MiB that a cell may add.")] = None,
    dask: Annotated[str | None, Option(help="Address of a Dask scheduler, instead of local workers.")] = None,
    shard: Annotated[
        str | None, Option(metavar="k/n", help="Part k of n; isacbench merge joins them.")
    ] = None,
    rerun: Annotated[
        list[str] | None,
        Option(metavar="failed|stale|all", help="Cells of an existing folder to run again; repeats."),
    ] = None,
    mix_versions: MixVersions = False,
    timing: Annotated[bool, Option("--timing", help="Measure run times, one cell after the other.")] = False,
    repeats: Annotated[int | None, Option(min=1, help="Timed estimates a cell; default 5.")] = None,
    html: Html = True,
) -> None:
    """Run a suite: estimate, score, tabulate, draw. An existing folder of the same run is completed."""
    from isacbench.bench.suites.suite import find_suite, parse_snr

    if out is None and (rerun or mix_versions):
        raise InputError("--rerun and --mix-versions need -o DIR, the folder of an existing run")
    register(plugin)
    find_suite(suite)
    require_names(scenario or (), estimator or (), metrics=metric or ())
    if dask is None:
        from isacbench.bench.workers.guarded_process import start_process_server

        start_process_server()  # it imports what workers need while this process imports the rest
    from isacbench.bench.kinds.population import PopulationSuite
    from isacbench.bench.suites.suite_kinds import kind_of, load_suite, with_metrics

    wanted = load_suite(suite)
    if block:
        if not isinstance(wanted, PopulationSuite):
            raise InputError(
                f"--block {block}: suite {wanted.name} is no population, which has blocks of seeds"
            )
        if scenario:
            raise InputError(
                f"--block {block} takes other scenes than -s {scenario[0]}; allowed is one of them"
            )
        wanted = wanted.in_block(block)
    wanted = wanted.replace(
        estimators=estimator,
        scenarios=scenario,
        snr_db=None if snr is None else parse_snr(snr),
        trials=trials,
        seed=seed,
    )
    wanted = with_metrics(wanted, metric or ())
    require_names(
        wanted.scenarios,
        wanted.estimators,
        getattr(wanted, "detectors", ()),
        kind_of(wanted).metric_specs(wanted),
    )
    from isacbench.bench.cells.cell import repeats_wanted
    from isacbench.bench.cells.record import failed
    from isacbench.bench.plan.labels import estimator_labels
    from isacbench.bench.plan.run_plan import Shard
    from isacbench.bench.run.runner import Execution
    from isacbench.bench.store.manifest import command_to_show
    from isacbench.bench.store.resume import parse_reruns
    from isacbench.bench.store.run_folder import default_folder
    from isacbench.bench.workers.guarded_cells import Guard

    execution = Execution(
        n_jobs=jobs or (1 if dask is None else None),
        guard=Guard(
            timeout_s=None if timeout == math.inf else timeout,
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
            run = _run_and_report(wanted, folder, execution, html)
        except KeyboardInterrupt:
            termination.fail(_describe_left(folder))
        if run.manifest["interrupted"]:
            termination.fail(f"the {len(run.rows)} cells so far are in {folder}")
    lost = run.rows[failed(run.rows)]
    if not lost.empty:
        first = lost.iloc[0]
        label = estimator_labels([(first["estimator"], first["params"])])[first["estimator"], first["params"]]
        command = command_to_show(run.manifest, first["scenario"], label, first["snr_db"], first["trial"])
        fail(
            f"{len(lost)} of {len(run.rows)} cells failed, the first one {first['estimator']} on "
            f"{first['scenario']} at {first['snr_db']:g} dB, trial {first['trial']}: {first['status']}, "
            f"{first['reason']}{f'; again: {command}' if command else ''}",
            EXIT_FAILED_CELLS,
        )


def _run_and_report(suite: Suite, folder: Path, execution: Execution, with_page: bool) -> Run:
    """Run a suite and make tables and figures of its rows, also after an interrupt."""
    from isacbench.bench.run.looks import record_look
    from isacbench.bench.run.runner import run_suite

    if (log := record_look(suite)) is not None:
        say(f"{log}: this look at reporting scenes is recorded; commit it")
    with progress_shown(suite.name, is_idle=execution.is_timing) as show:
        run = run_suite(suite, folder, show, execution)
    if not run.rows.empty:
        report_run(run, with_page)
    return run


def _describe_left(folder: Path) -> str:
    """Describe what is stored after an interrupt outside the work on cells."""
    from isacbench.bench.store.run_folder import MANIFEST

    if not (folder / MANIFEST).exists():
        return "nothing is done yet"
    return f"what is done so far is in {folder}; isacbench report {folder} tabulates it"
