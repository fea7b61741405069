"""Commands on the results of runs: draw again, join, score again, compare."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from isacbench.cli.app import EXIT_NOT_COMPARABLE, EXIT_REGRESSION, app, fail, say
from isacbench.cli.options import AsJson, PluginFiles, register
from isacbench.cli.printing import print_grid, print_json, report_run

__all__ = ["compare", "merge", "report", "rescore"]

GAPS_SHOWN = 10
"""Lines about missing cells; whoever misses more has not merged all parts yet."""


@app.command()
def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a run.")],
    plugin: PluginFiles = None,
) -> None:
    """Redraw tables and figures of a run, without running again."""
    from isacbench.bench.store import read_results

    register(plugin)
    results = read_results(folder)
    report_run(folder, results.records, results.suite.kind)


@app.command()
def merge(
    folders: Annotated[
        list[Path], typer.Argument(metavar="DIR...", help="Folders of runs of one suite, such as its shards.")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="OUT", help="New folder for all of them.")],
    mix_versions: Annotated[
        bool, typer.Option("--mix-versions", help="Join rows of an estimator that several versions made.")
    ] = False,
    plugin: PluginFiles = None,
) -> None:
    """Join parts of a run: its shards, or runs of one suite with other estimators, SNRs or trials."""
    from isacbench.bench.merge import merge as merge_runs
    from isacbench.report.tables import estimator_labels

    register(plugin)
    merged = merge_runs(folders, out, mix_versions)
    if not merged.records.empty:
        report_run(out, merged.records, merged.kind)
    say(f"{out}: {len(merged.records)} of {merged.n_cells} cells")
    made = zip(merged.records["estimator"], merged.records["params"], strict=True)
    labels = estimator_labels([*made, *((gap.estimator, gap.params) for gap in merged.gaps)])
    for gap in merged.gaps[:GAPS_SHOWN]:
        trials = f"trial{'s' if len(gap.trials) > 1 else ''} {', '.join(map(str, gap.trials))}"
        label = labels[gap.estimator, gap.params]
        say(f"missing: {gap.n_cells} cells of {label} on {gap.scenario}, {trials}")
    if len(merged.gaps) > GAPS_SHOWN:
        say(f"missing: and of {len(merged.gaps) - GAPS_SHOWN} more")


@app.command()
def rescore(folder: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")]) -> None:
    """Score the clouds of a run again, without estimating: after a change of the metric, say."""
    from isacbench.bench.rescore import rescore as rescore_run

    rescored = rescore_run(folder)
    if not rescored.records.empty:
        report_run(folder, rescored.records, rescored.kind)
    say(f"{folder}: {rescored.n_scored} rows scored again, {rescored.n_changed} of them differ")
    for change in rescored.changes:
        say(f"{change.column}: {change.n_rows} rows, by at most {change.largest:.6g}")


@app.command()
def compare(
    base: Annotated[Path, typer.Argument(metavar="BASE", help="Folder of the run to compare with.")],
    new: Annotated[Path, typer.Argument(metavar="NEW", help="Folder of the run to judge.")],
    tolerance: Annotated[
        list[str] | None,
        typer.Option(
            "--tolerance",
            metavar="NAME=5%",
            help="Tolerated change of a score, in % of BASE or in its unit; repeats. Always: deviation=5%.",
        ),
    ] = None,
    alpha: Annotated[
        float, typer.Option("--alpha", metavar="0.01", help="Probability of any false regression, at most.")
    ] = 0.01,
    plot: Annotated[
        Path | None,
        typer.Option("--plot", metavar="picture.png", help="Default NEW/figures/compare-<score>.png."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare two runs: exit code 4 if a curve got worse, 5 if they cannot be compared."""
    from isacbench.bench.compare import compare as compare_runs
    from isacbench.bench.pairing import NotComparableError, read_run
    from isacbench.bench.tolerance import parse_tolerance
    from isacbench.report import comparison_tables as tables
    from isacbench.report.comparison import comparison_paths, draw_comparison_files

    tolerances = [parse_tolerance(text) for text in tolerance or []]
    try:
        found = compare_runs(read_run(base), read_run(new), tolerances, alpha)
    except NotComparableError as error:
        if as_json:
            print_json({"comparable": False, "reasons": error.reasons})
            raise typer.Exit(EXIT_NOT_COMPARABLE) from error
        fail("not comparable: " + "; ".join(error.reasons), EXIT_NOT_COMPARABLE)
    comparison_paths(found, new, plot)  # a wrong name is told before anything else
    if as_json:
        print_json(tables.comparison_content(found))
    else:
        say(f"base {found.base}: isacbench {found.base_version}")
        say(f"new  {found.new}: isacbench {found.new_version}")
        for grid in tables.comparison_grids(found):
            print_grid(grid)
        for line in tables.comparison_lines(found):
            say(line)
    if plot is not None or not as_json:
        figures = draw_comparison_files(found, new, plot)
        if figures and not as_json:
            say(f"figures: {', '.join(map(str, figures))}")
    if not as_json:
        say(tables.comparison_summary(found))
    if found.is_regression:
        raise typer.Exit(EXIT_REGRESSION)
