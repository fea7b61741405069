"""Commands on plugins: list, check, stress."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from isacbench.cli import options as opt
from isacbench.cli.app import Exit, app, fail, print_json, print_tables, say, say_lines
from isacbench.errors import InputError, import_extra
from isacbench.files.escaping import plural

if TYPE_CHECKING:
    from isacbench.checking.checks import Family
    from isacbench.checking.stress import CaseResult, Target

TIMEOUT_S = 120.0
"""Equal to `isacbench.checking.stress.TIMEOUT_S`, whose import takes long."""


@app.command("list")
def list_command(as_json: opt.AsJson = False, plugin: opt.PluginFiles = None) -> None:
    """List estimators, detectors, metrics, scenarios, families of scenes and suites."""
    from isacbench.bench.suites.suite_kinds import catalogue
    from isacbench.specifications import spell_value

    opt.register(plugin)
    content = catalogue()
    if as_json:
        print_json(content)
        return
    for section, entries in content.items():
        say(f"{section}:")
        for entry in entries:
            say(f"  {entry['name']:<17} {entry['description']}")
            for name, parameter in entry.get("parameters", {}).items():
                default = f" = {spell_value(parameter['default'])}" if "default" in parameter else ""
                allowed = f", {parameter['allowed']}" if "allowed" in parameter else ""
                say(f"      {name}: {parameter['type']}{allowed}{default}")


@app.command("check")
def check_command(
    package_or_file: Annotated[str, Argument(help="Package, .py file, or registered name.")],
    as_json: opt.AsJson = False,
    plugin: opt.PluginFiles = None,
) -> None:
    """Check estimators, detectors and metrics against the contract, and say what to correct."""
    from isacbench.checking.plugin_check import CheckReport, PluginFindings, check_guarded, find_plugins

    opt.register(plugin)
    entries = find_plugins(package_or_file)
    from isacbench.report import findings as texts

    found = []
    for entry in entries:

        def still_at(running: str, of: str = f"{entry.kind} {entry.name}") -> None:
            say(f"isacbench: {of}: still at {running!r}", err=True)

        findings = tuple(check_guarded(entry, still_at=still_at))
        found.append(PluginFindings(entry.kind, entry.name, entry.origin, findings))
        if not as_json:
            texts.print_findings(found[-1])
    report = CheckReport(tuple(found))
    if as_json:
        print_json(texts.describe_checks(report))
    else:
        say(texts.counts_line(report))
    if not report.ok:
        raise typer.Exit(Exit.FAILED_CELLS)


@app.command("stress")
def stress_command(
    estimator: opt.EstimatorSpecs = None,
    detector: Annotated[
        list[str] | None, Option("-d", "--detector", metavar=opt.SPEC, help="Detector, likewise; repeats.")
    ] = None,
    case: Annotated[
        list[str] | None, Option(metavar="FAMILY[param=value,...]", help="Case, or all of a family; repeats.")
    ] = None,
    search: Annotated[
        int | None, Option(min=1, help="Draw as many cases a family at random instead.")
    ] = None,
    seed: opt.Seed = 0,
    out: Annotated[Path | None, opt.out_option(metavar="DIR", help="Default results/stress-<time>.")] = None,
    jobs: Annotated[int, Option("-j", "--jobs", min=1, help="Worker processes.")] = 1,
    timeout: Annotated[float, Option(min=0.001, help="Longest time of a case in seconds.")] = TIMEOUT_S,
    plugin: opt.PluginFiles = None,
    as_json: opt.AsJson = False,
) -> None:
    """Put estimators and detectors through hostile but finite input, and say what breaks.

    Without -e and -d: all, but references, which see the truth. --search needs isacbench[stress].
    """
    opt.register(plugin)
    opt.require_names(estimators=estimator or (), detectors=detector or ())
    from isacbench.bench.cells.process import start_process_server

    start_process_server()
    from isacbench.bench.store.run_folder import default_folder
    from isacbench.checking import stress
    from isacbench.plugins.registry import detector_names, estimator_names, sees_truth
    from isacbench.report import findings

    if estimator is None and detector is None:
        estimator = [name for name in estimator_names() if not sees_truth(name)]
        detector = detector_names()
    targets = stress.find_targets("estimator", estimator or ())
    targets += stress.find_targets("detector", detector or ())
    if search is None:
        running = stress.run_cases(stress.tasks_of(targets, case or [], seed), jobs, timeout)
    else:
        if jobs > 1:
            raise InputError(
                f"--jobs {jobs}: --search needs --jobs 1, each case depends on the previous ones"
            )
        import_extra("hypothesis", "stress", f"--search {search}")
        families = stress.find_families(case or [], {target.kind for target in targets})

        def begin(target: Target, family: Family) -> None:  # a search takes a while
            say(f"searching {family.name} for {target.spec}", err=True)

        running = stress.search(targets, families, search, seed, timeout, begin)
    results: list[CaseResult] = []
    interrupted = False
    folder = default_folder("stress") if out is None else out
    with stress.stress_folder(folder, results, timeout):
        if not as_json:
            say(findings.HEADER)
        try:
            for result in running:
                results.append(result)
                if not as_json:
                    say_lines(findings.line(result))
        except KeyboardInterrupt:
            interrupted = True
    if as_json:
        print_json(findings.describe_stress(results))
    else:
        if search is None and results:
            promises = findings.promise_grid(stress.check_table(results))
            print_tables(promises, findings.family_grid(stress.case_table(results)))
        if search is None or interrupted:
            say(findings.summary(results))
        else:
            count = plural(len(results), "finding") if results else "no finding"
            say(f"searched {search} cases a family for {plural(len(targets), 'target')}: {count}")
        say(f"{folder}: {', '.join(stress.FILES)}")
    if interrupted:
        fail(f"interrupted: the {len(results)} cases so far are in {folder}", Exit.INTERRUPTED)
    broken = [result for result in results if result.is_broken]
    if broken:
        fail(f"{plural(len(broken), 'finding')}; the first one: {broken[0].reproduce}", Exit.FAILED_CELLS)
