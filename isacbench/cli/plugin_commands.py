"""Commands on plugins: list, check."""

from __future__ import annotations

from typing import Annotated

import typer

from isacbench.cli.app import EXIT_FAILED_CELLS, app, say
from isacbench.cli.options import AsJson, PluginFiles, register
from isacbench.cli.printing import print_json


@app.command("list")
def list_command(as_json: AsJson = False, plugin: PluginFiles = None) -> None:
    """List estimators, detectors, metrics, scenarios, families of scenes and suites."""
    from isacbench.bench.suites.suite_kinds import catalogue
    from isacbench.specifications import spell_value

    register(plugin)
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
    package_or_file: Annotated[
        str, typer.Argument(metavar="PACKAGE_OR_FILE", help="Package, .py file, or registered name.")
    ],
    as_json: AsJson = False,
    plugin: PluginFiles = None,
) -> None:
    """Check estimators, detectors and metrics against the contract, and say what to correct."""
    from isacbench.checking.plugin_check import CheckReport, PluginFindings, check_guarded, find_plugins

    register(plugin)
    plugins = find_plugins(package_or_file)
    from isacbench.plugins.discovery import entries
    from isacbench.report.findings import describe_checks, print_counts, print_findings

    found = []
    for kind, name in plugins:

        def still_at(running: str, of: str = f"{kind} {name}") -> None:
            say(f"isacbench: {of}: still at {running!r}", err=True)

        findings = tuple(check_guarded(kind, name, still_at=still_at))
        found.append(PluginFindings(kind, name, entries(kind)[name].origin, findings))
        if not as_json:
            print_findings(found[-1])
    report = CheckReport(tuple(found))
    if as_json:
        print_json(describe_checks(report))
    else:
        print_counts(report)
    if not report.ok:
        raise typer.Exit(EXIT_FAILED_CELLS)
