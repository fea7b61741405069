"""Commands on the results of runs: report, merge, rescore, compare, rank."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

import isacbench
from isacbench.cli import options as opt
from isacbench.cli.app import Exit, app, fail, print_json, print_tables, report_run, say
from isacbench.errors import InputError
from isacbench.files.checked_files import path_exists, require_replaceable

RANK_METRIC = "Score to rank by, such as f_score, objects_detected or deviation; default ratio."

GAPS_SHOWN = 10
"""Largest number of lines about missing cells."""


@app.command("report")
def report_command(
    folders: Annotated[list[Path], Argument(metavar="DIR...", help="Run; with --html several of one suite.")],
    html: Annotated[bool | None, opt.html_option(help="The interactive page alone, or all but it.")] = None,
    out: Annotated[Path | None, opt.out_option(metavar="FILE.html", help="Page of several runs.")] = None,
    scenario: Annotated[str | None, Option(help="Draw figures of this scenario alone.")] = None,
    snr: Annotated[float | None, Option(help="Draw clouds, maps and spectra at this SNR in dB.")] = None,
    trial: Annotated[int | None, Option(min=0, help="Draw clouds, maps and spectra of this trial.")] = None,
    metric: Annotated[str | None, Option(help="Score over SNR.", autocompletion=opt.curves_like)] = None,
    extension: Annotated[str | None, Option("--format", metavar="png|pdf|svg", help="Of figures.")] = None,
    plugin: opt.PluginFiles = None,
) -> None:
    """Make tables, figures and page of a run again, figures for a paper, or one page of several runs."""
    from isacbench.bench.store.run import Run
    from isacbench.report.html import written_pages
    from isacbench.report.run_report import FigureChoice, draw_run

    opt.register(plugin)
    choice = FigureChoice(scenario, snr, trial, metric)
    is_choice = choice != FigureChoice() or extension is not None
    if html and is_choice:
        raise InputError("--html cannot be combined with --scenario, --snr, --trial, --metric and --format")
    if len(folders) > 1 or out is not None:
        if not html:
            raise InputError("several folders, and -o, need --html; without it give one folder")
        path = Path(written_pages.LEADERBOARD_PAGE) if out is None else out
        if path.suffix != ".html":
            raise InputError(f"{path}: a page is written as .html; give -o FILE.html")
        require_replaceable(path)
        say(str(written_pages.write_leaderboard([Run.open(folder) for folder in folders], path)))
    elif html:
        say(str(written_pages.write_run_page(Run.open(folders[0]))))
    elif is_choice:
        _say_figures(draw_run(Run.open(folders[0]), choice, extension or "png"))
    else:
        report_run(Run.open(folders[0]), html is None)


@app.command("merge")
def merge_command(
    folders: Annotated[list[Path], Argument(help="Folders of runs of one suite, such as its shards.")],
    out: Annotated[Path, opt.out_option(help="New folder for all of them.")],
    mix_versions: opt.MixVersions = False,
    plugin: opt.PluginFiles = None,
) -> None:
    """Join shards of a run, or runs of one suite with other estimators."""
    from isacbench.bench.labels import estimator_labels
    from isacbench.bench.run.merging import merge as merge_runs
    from isacbench.charts import variants_in

    opt.register(plugin)
    merged = merge_runs(folders, out, mix_versions)
    if not merged.run.rows.empty:
        report_run(merged.run)
    say(f"{out}: {len(merged.run.rows)} of {merged.n_cells} cells")
    variants = variants_in(merged.run.rows)
    labels = estimator_labels([*variants, *((gap.estimator, gap.params) for gap in merged.gaps)])
    for gap in merged.gaps[:GAPS_SHOWN]:
        label, trials = labels[gap.estimator, gap.params], ", ".join(map(str, gap.trials))
        say(f"missing: {gap.n_cells} cells of {label} on {gap.scenario}, trials {trials}")
    if len(merged.gaps) > GAPS_SHOWN:
        say(f"missing: and of {len(merged.gaps) - GAPS_SHOWN} more")


@app.command("rescore")
def rescore_command(
    folder: Annotated[Path, Argument(metavar="RUN", help="Folder of a run.")],
    metric: opt.MetricSpecs = None,
    plugin: opt.PluginFiles = None,
) -> None:
    """Score the stored clouds of a run again, also by further metrics, without running it again."""
    from isacbench.bench.run.rescoring import rescore as rescore_run

    opt.register(plugin)
    opt.require_names(metrics=metric)
    rescored = rescore_run(folder, metric or ())
    if not rescored.run.rows.empty:
        report_run(rescored.run)
    say(f"{folder}: {rescored.n_scored} rows scored again, {rescored.n_changed} of them differ")
    say(*map(str, rescored.changes))


@app.command("compare")
def compare_command(
    base: Annotated[Path, Argument(metavar="BASE", help="Run to compare with, or the only one.")],
    new: Annotated[Path | None, Argument(metavar="NEW", help="Run to judge.")] = None,
    mapped: Annotated[
        list[str] | None,
        Option("--map", metavar="OLD[...]=NEW[...]", help="Pair two estimators of BASE and NEW; repeats."),
    ] = None,
    between: Annotated[str | None, Option(metavar="A[...]", help="Estimator of BASE; needs --and.")] = None,
    other: Annotated[str | None, Option("--and", metavar="B[...]", help="Another one, to judge.")] = None,
    tolerance: Annotated[
        list[str] | None, Option(metavar="NAME=5%", help="Tolerated change, in % or the unit; repeats.")
    ] = None,
    alpha: Annotated[float, Option(help="Largest probability of any false regression.")] = 0.01,
    plot: Annotated[Path | None, Option(help="Picture; default NEW/figures/compare-<score>.png.")] = None,
    markdown: Annotated[Path | None, Option(help="Write a summary in Markdown.")] = None,
    junit: Annotated[Path | None, Option(help="Write JUnit XML for continuous integration.")] = None,
    html: opt.Html = True,
    as_json: opt.AsJson = False,
) -> None:
    """Compare two runs, or two estimators of one.

    Exit code 4 if a curve is worse or cells are lost, 5 if the runs cannot be compared.
    """
    from isacbench.bench.store.run import Run
    from isacbench.report import comparison
    from isacbench.report.html.written_pages import write_comparison_page

    if (between is None) != (other is None):
        raise InputError("--between and --and must be given together")
    _require_own_places([path for path in (markdown, junit) if path is not None])
    runs = [Run.open(path) for path in (base, new) if path is not None]
    pair = (between, other) if between is not None and other is not None else None
    try:
        found = isacbench.compare(
            *runs, map=mapped or (), between=pair, tolerances=tolerance or (), alpha=alpha
        )
    except isacbench.NotComparableError as error:
        _write(markdown, comparison.incomparable_markdown(str(base), str(new), error.reasons))
        _write(junit, comparison.incomparable_junit(str(base), str(new), error.reasons))
        if as_json:
            print_json({"comparable": False, "reasons": error.reasons})
            raise typer.Exit(Exit.NOT_COMPARABLE) from error
        fail("not comparable: " + "; ".join(error.reasons), Exit.NOT_COMPARABLE)
    report, folder = comparison.ComparisonReport(found), runs[-1].folder
    report.paths(folder, plot)  # refuses a wrong name before anything is written
    _write(markdown, comparison.comparison_markdown(found))
    _write(junit, comparison.comparison_junit(found))
    if as_json:
        print_json(report.content())
        if plot is not None:
            report.draw(folder, plot)
    else:
        say(*report.heading, *report.effect_lines())
        print_tables(*report.tables())
        say(*report.lines())
        if plot is None:
            _draw_into(folder, lambda: report.draw(folder))
        else:  # a wrong place is the user's, and ends the command
            _say_figures(report.draw(folder, plot))
        if html:
            _draw_into(folder, lambda: [write_comparison_page(found, runs)], "page")
        say(report.summary())
    if found.is_regression:
        raise typer.Exit(Exit.REGRESSION)


@app.command("rank")
def rank_command(
    folder: Annotated[Path, Argument(metavar="RUN", help="Folder of a run of six scenes or more.")],
    metric: Annotated[str | None, Option(help=RANK_METRIC, autocompletion=opt.metrics_like)] = None,
    estimator: Annotated[
        list[str] | None, opt.estimator_option(help="Rank these alone, chosen before looking; repeats.")
    ] = None,
    html: opt.Html = True,
    as_json: opt.AsJson = False,
) -> None:
    """Rank the estimators of a run over its scenes: rank sets, win probabilities, worst scenes."""
    from isacbench.bench.store.run import Run
    from isacbench.report import ranking
    from isacbench.report.html.written_pages import write_rank_page

    run = Run.open(folder)
    found = isacbench.rank(run, metric, estimator)
    if as_json:
        print_json(ranking.ranking_content(found))
        return
    print_tables(*ranking.ranking_tables(found))
    say(*ranking.ranking_lines(found))
    if not found.is_descriptive:
        _draw_into(folder, lambda: [ranking.draw_ranking_file(found, folder)])
    if html:
        _draw_into(folder, lambda: [write_rank_page(run, found.metric)], "page")


def _require_own_places(paths: list[Path]) -> None:
    """Refuse files that cannot be written, or are tables of a run."""
    from isacbench.bench.store.run_folder import RUN_TABLES

    for path in paths:
        require_replaceable(path)
        if path.name in RUN_TABLES and path_exists(path):
            raise InputError(f"{path}: is a table of a run and is not overwritten; choose another name")


def _draw_into(folder: Path, draw: Callable[[], list[Path]], noun: str = "figures") -> None:
    """Draw figures into the folder of a run, or say why that cannot be."""
    from isacbench.bench.store.run_folder import require_unlocked

    try:
        require_unlocked(folder)
        _say_figures(draw(), noun)
    except InputError as error:
        say(f"no {noun}: {error}")


def _say_figures(figures: list[Path], noun: str = "figures") -> None:
    if figures:
        say(f"{noun}: {', '.join(map(str, figures))}")


def _write(path: Path | None, text: str) -> None:
    """Write a file, if one is asked for, in place of an older one."""
    from isacbench.bench.store.run_folder import atomic_write

    if path is not None:
        with atomic_write(path, afterwards="") as temporary:
            temporary.write_text(text, encoding="utf-8", newline="")
