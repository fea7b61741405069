"""The command that puts estimators and detectors under stress."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from isacbench.cli.app import EXIT_FAILED_CELLS, EXIT_INTERRUPTED, app, fail, say, say_lines
from isacbench.cli.options import SEED_HELP, AsJson, EstimatorSpecs, PluginFiles, register, require_names
from isacbench.cli.printing import print_json, print_table
from isacbench.errors import InputError
from isacbench.files.escaping import counted

if TYPE_CHECKING:
    from isacbench.checking.case import Family
    from isacbench.checking.stress import CaseResult, Target

TIMEOUT_S = 120.0
"""Equal to `isacbench.checking.stress.TIMEOUT_S`, whose import takes long."""


@app.command("stress")
def stress_command(
    estimator: EstimatorSpecs = None,
    detector: Annotated[
        list[str] | None,
        typer.Option(
            "-d", "--detector", metavar="NAME[param=value,...]", help="Detector, likewise; repeats."
        ),
    ] = None,
    case: Annotated[
        list[str] | None,
        typer.Option("--case", metavar="FAMILY[param=value,...]", help="Case, or all of a family; repeats."),
    ] = None,
    search: Annotated[
        int | None,
        typer.Option(
            "--search",
            metavar="N",
            min=1,
            help="Draw N cases a family at random, instead of the table; needs isacbench[stress].",
        ),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", metavar="SEED", min=0, help=SEED_HELP)] = 0,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="DIR", help="Folder; default results/stress-<time>."),
    ] = None,
    jobs: Annotated[int, typer.Option("-j", "--jobs", metavar="JOBS", min=1, help="Worker processes.")] = 1,
    timeout: Annotated[
        float, typer.Option("--timeout", metavar="SECONDS", min=0.001, help="Longest time of a case.")
    ] = TIMEOUT_S,
    plugin: PluginFiles = None,
    as_json: AsJson = False,
) -> None:
    """Put estimators and detectors through hostile but finite input, and say what breaks.

    Without -e and -d: all, but references, which see the truth.
    """
    register(plugin)
    require_names(estimators=estimator or (), detectors=detector or ())
    from isacbench.bench.workers.guarded_process import start_process_server

    start_process_server()
    from isacbench.bench.store.run_folder import default_folder
    from isacbench.checking import stress
    from isacbench.plugins.registry import detector_names, estimator_names, sees_truth
    from isacbench.report import findings as stress_findings

    if estimator is None and detector is None:
        estimator = [name for name in estimator_names() if not sees_truth(name)]
        detector = detector_names()
    targets = [
        *stress.find_targets("estimator", estimator or ()),
        *stress.find_targets("detector", detector or ()),
    ]
    if search is None:
        running = stress.run_cases(stress.tasks_of(targets, case or [], seed), jobs, timeout)
    else:
        _require_search(search, jobs)
        families = stress.find_families(case or [], {target.kind for target in targets})
        running = stress.search(targets, families, search, seed, timeout, _say_family)
    results: list[CaseResult] = []
    interrupted = False
    folder = default_folder("stress") if out is None else out
    with stress.open_stress_folder(folder):
        try:
            if not as_json:
                say(stress_findings.HEADER)
            for result in running:
                results.append(result)
                if not as_json:
                    say_lines(stress_findings.line(result))
        except KeyboardInterrupt:
            interrupted = True
        finally:
            # Whatever ends this, a terminal that is gone included.
            paths = stress.write_stress_tables(folder, results, timeout_s=timeout)
    if as_json:
        print_json(stress_findings.describe_stress(results))
    else:
        if search is None and results:
            print_table(stress_findings.promise_grid(stress.check_table(results)))
            print_table(stress_findings.family_grid(stress.case_table(results)))
        if search is None or interrupted:
            say(stress_findings.summary(results))
        else:
            say(stress_findings.search_summary(results, search, len(targets)))
        say(f"{folder}: {', '.join(path.name for path in paths)}")
    if interrupted:
        fail(f"interrupted: the {len(results)} cases so far are in {folder}", EXIT_INTERRUPTED)
    broken = [result for result in results if result.is_broken]
    if broken:
        fail(f"{counted(len(broken), 'finding')}; the first one: {broken[0].reproduce}", EXIT_FAILED_CELLS)


def _require_search(n_examples: int, jobs: int) -> None:
    """Refuse a search that cannot be made."""
    if jobs > 1:
        raise InputError(
            f"--jobs {jobs}: --search needs --jobs 1, because each case depends on the previous ones"
        )
    if find_spec("hypothesis") is None:
        raise InputError(
            f'--search {n_examples}: the package `hypothesis` is missing; pip install "isacbench[stress]"'
        )


def _say_family(target: Target, family: Family) -> None:
    """Announce the next family on stderr, for a search takes a while."""
    say(f"searching {family.name} for {target.spec}", err=True)
