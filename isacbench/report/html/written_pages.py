"""Pages of runs, rankings, comparisons and leaderboards, written into files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from isacbench.bench.store.run import Run
from isacbench.errors import InputError
from isacbench.report.html.comparison_content import compared_content
from isacbench.report.html.diagnosed_maps import diagnosed_maps
from isacbench.report.html.joined_runs import join_runs
from isacbench.report.html.page_content import DEFAULT_METRIC, page_content
from isacbench.report.html.page_file import write_page

if TYPE_CHECKING:
    from collections.abc import Sequence

    from isacbench.bench.compare.comparison import Comparison

RUN_PAGE = "report.html"
RANK_PAGE = "rank.html"
LEADERBOARD_PAGE = "leaderboard.html"
COMPARISON_PAGES = {False: "compare.html", True: "between.html"}
"""Name of the page of a comparison of runs, and of one of two estimators."""


def write_run_page(run: Run) -> Path:
    """Write the page of a run, ``report.html``, into its folder.

    Maps and spectra are computed anew; a diagnosis that fails costs its own with a warning.
    """
    name = run.folder.resolve().name
    content, clouds = page_content(join_runs([run.changed(label=name)]))
    path = run.folder / RUN_PAGE
    write_page(path, f"{name} - isacbench", {**content, "maps": diagnosed_maps(run)}, clouds)
    return path


def write_rank_page(run: Run, metric: str | None = None) -> Path:
    """Write the page of a ranking, ``rank.html``, into the folder of its run."""
    name = run.folder.resolve().name
    content, clouds = page_content(join_runs([run.changed(label=name)]), metric)
    path = run.folder / RANK_PAGE
    write_page(path, f"{name} ranked - isacbench", content, clouds)
    return path


def write_comparison_page(comparison: Comparison, compared: Sequence[Run]) -> Path:
    """Write the page of a comparison of two runs, or of two estimators of one, into the folder of the last.

    It is ``compare.html``, of two estimators of one run ``between.html``.
    """
    is_between = comparison.between is not None
    names = names_of([run.folder for run in compared])
    if not is_between and len(set(names)) < 2:
        names = ["base", "new"]
    runs = [run.changed(label=name) for run, name in zip(compared, names, strict=True)]
    joined = join_runs(runs, rename_all=True)
    found, is_shown = compared_content(comparison, joined)
    metric = comparison.tolerances[0].metric if comparison.tolerances else DEFAULT_METRIC
    content, clouds = page_content(joined, metric, is_shown)
    path = compared[-1].folder / COMPARISON_PAGES[is_between]
    title = f"{' and '.join(names)} compared - isacbench"
    write_page(path, title, {**content, "comparison": found}, clouds)
    return path


def write_leaderboard(runs: Sequence[Run], out: Path) -> Path:
    """Write one HTML page of several runs of one suite, with the same seed, metric and scenes.

    SNRs and trials that not all of them have are left out.
    """
    folders = [run.folder for run in runs]
    if len({folder.resolve() for folder in folders}) < len(folders):
        raise InputError("a folder is given twice; give different runs")
    named = [run.changed(label=name) for run, name in zip(runs, names_of(folders), strict=True)]
    joined = join_runs(named, only_common=True)
    content, clouds = page_content(joined)
    write_page(out, f"{joined.table.manifest['suite']['name']}: leaderboard - isacbench", content, clouds)
    return out


def names_of(folders: Sequence[Path]) -> list[str]:
    """Name folders by their last part, or by their whole path where two share it.

    Examples
    --------
    >>> names_of([Path("mine/new"), Path("old")]), names_of([Path("a/run"), Path("b/run")])
    (['new', 'old'], ['a/run', 'b/run'])
    """
    short = [folder.resolve().name for folder in folders]
    return short if len(set(short)) == len(short) else [str(folder) for folder in folders]
