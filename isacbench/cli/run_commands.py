"""The command that runs a suite, and its end by a signal."""

from __future__ import annotations

import math
import os
import signal
import time
from contextlib import nullcontext
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, NoReturn, Self

from typer import Option

from isacbench.bench.run.progress import Progress, progress_shown
from isacbench.cli import options as opt
from isacbench.cli.app import Exit, app, fail, report_run, say
from isacbench.errors import InputError

OUT_HELP = "Folder, new or of the same run to go on with; default results/<suite>-<time>."


@app.command("run")
def run_command(
    suite: opt.SuiteName = "paper",
    estimator: opt.EstimatorSpecs = None,
    scenario: opt.ScenarioNames = None,
    snr: Annotated[str | None, Option(metavar="-30:20:5", help="SNRs in dB: a range, a list or one.")] = None,
    trials: Annotated[int | None, Option("-n", "--trials", min=1, help="Number of noise draws.")] = None,
    seed: opt.OptionalSeed = None,
    out: Annotated[Path | None, opt.out_option(metavar="DIR", help=OUT_HELP)] = None,
    plugin: opt.PluginFiles = None,
    metric: opt.MetricSpecs = None,
    block: Annotated[int, Option(help="Take the k-th next block of seeds of a population.")] = 0,
    jobs: Annotated[int | None, Option("-j", "--jobs", min=1, help="Worker processes; default 1.")] = None,
    timeout: Annotated[float, Option(help="Longest time of a cell in seconds, or inf.")] = 600.0,
    memory: Annotated[float | None, Option(help="Most memory in MiB that a cell may add.")] = None,
    dask: Annotated[str | None, Option(help="Address of a Dask scheduler, instead of local workers.")] = None,
    shard: Annotated[str | None, Option(metavar="k/n", help="Part k of n, for isacbench merge.")] = None,
    rerun: Annotated[
        list[str] | None, Option(metavar="failed|stale|all", help="Cells to run again; repeats.")
    ] = None,
    mix_versions: opt.MixVersions = False,
    timing: Annotated[bool, Option("--timing", help="Measure run times, one cell after the other.")] = False,
    repeats: Annotated[int | None, Option(min=1, help="Timed estimates a cell; default 5.")] = None,
    html: opt.Html = True,
) -> None:
    """Run a suite: estimate, score, tabulate, draw. An existing folder of the same run is completed."""
    from isacbench.bench.suites.suite import find_suite, parse_snr

    if out is None and (rerun or mix_versions):
        raise InputError("--rerun and --mix-versions need -o DIR, the folder of an existing run")
    opt.register(plugin)
    find_suite(suite)
    opt.require_names(scenario, estimator, metrics=metric)
    if dask is None:
        from isacbench.bench.cells.process import start_process_server

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
    snrs_db = None if snr is None else parse_snr(snr)
    wanted = wanted.replace(
        estimators=estimator, scenarios=scenario, snr_db=snrs_db, trials=trials, seed=seed
    )
    wanted = with_metrics(wanted, metric or ())
    detectors, metrics = getattr(wanted, "detectors", ()), kind_of(wanted).metric_specs(wanted)
    opt.require_names(wanted.scenarios, wanted.estimators, detectors, metrics)
    from isacbench.bench.cells.rows import failed
    from isacbench.bench.labels import estimator_labels
    from isacbench.bench.run.looks import record_look
    from isacbench.bench.run.runner import RunOptions, run_suite
    from isacbench.bench.store.manifest import command_to_show
    from isacbench.bench.store.run_folder import MANIFEST, default_folder
    from isacbench.report.drawing import DrawingProcess

    options = RunOptions(
        jobs=jobs or (1 if dask is None else None),
        timeout_s=None if timeout == math.inf else timeout,
        memory_mib=None if memory == math.inf else memory,
        dask=dask,
        shard=shard,
        rerun=rerun or (),
        mix_versions=mix_versions,
        timing=timing,
        repeats=repeats,
    )
    folder = default_folder(wanted.name) if out is None else out
    is_alone = options.timing or dask is not None  # nothing else works beside cells that are timed
    drawing = nullcontext() if is_alone else DrawingProcess("isacbench.report.run_report")
    with Termination() as termination, drawing as helper:
        try:
            if (log := record_look(wanted)) is not None:
                say(f"{log}: this look at reporting scenes is recorded; commit it")
            with progress_shown(wanted.name, is_idle=options.timing) as show:
                run = run_suite(wanted, folder, termination.interrupting(show), options)
            if not run.rows.empty:
                report_run(run, html, helper)
        except KeyboardInterrupt:
            left = f"what is done so far is in {folder}; isacbench report {folder} tabulates it"
            termination.fail(left if (folder / MANIFEST).exists() else "nothing is done yet")
        if run.manifest["interrupted"]:
            termination.fail(f"the {len(run.rows)} cells so far are in {folder}")
    lost = run.rows[failed(run.rows)]
    if not lost.empty:
        first = lost.iloc[0]
        (label,) = estimator_labels([(first["estimator"], first["params"])]).values()
        command = command_to_show(run.manifest, first["scenario"], label, first["snr_db"], first["trial"])
        fail(
            f"{len(lost)} of {len(run.rows)} cells failed, the first one {first['estimator']} on "
            f"{first['scenario']} at {first['snr_db']:g} dB, trial {first['trial']}: {first['status']}, "
            f"{first['reason']}{f'; again: {command}' if command else ''}",
            Exit.FAILED_CELLS,
        )


SAME_S = 1.0
"""Signals within this time count as one: GNU timeout signals a process and then its group."""


class Termination:
    """Ctrl-C, and SIGTERM of job schedulers, containers and CI, while a command runs.

    Both raise KeyboardInterrupt in the main thread, so that the command can write what it has. A later
    SIGTERM ends the process at once.
    """

    def __init__(self) -> None:
        self._before: dict[int, Any] = {}
        self._received_s: dict[int, float] = {}

    def __enter__(self) -> Self:
        for number in (signal.SIGINT, signal.SIGTERM):
            if signal.getsignal(number) is not signal.SIG_IGN:  # as Ctrl-C is in the background of a shell
                self._before[number] = signal.signal(number, self._receive)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def interrupting(self, progress: Progress) -> Progress:
        """Let progress interrupt after a signal: Python swallows what is raised within ``__del__``."""

        def show(n_done: int, n_all: int) -> None:
            progress(n_done, n_all)
            if self._received_s:
                raise KeyboardInterrupt

        return show

    def fail(self, message: str) -> NoReturn:
        """End the command with a message that names the interrupt: SIGTERM if received, otherwise Ctrl-C."""
        if signal.SIGTERM in self._received_s:
            fail(f"terminated: {message}", Exit.TERMINATED)
        fail(f"interrupted: {message}", Exit.INTERRUPTED)

    def _receive(self, number: int, frame: FrameType | None) -> None:
        now_s = time.monotonic()
        first_s = self._received_s.setdefault(number, now_s)
        if number == signal.SIGINT or first_s == now_s:
            raise KeyboardInterrupt
        if now_s - first_s > SAME_S:
            os._exit(Exit.TERMINATED)
