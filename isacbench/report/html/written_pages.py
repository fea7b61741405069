"""Pages of runs, rankings, comparisons and leaderboards, written into files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from isacbench.errors import InputError
from isacbench.report.html.comparison_content import compared_content
from isacbench.report.html.joined_runs import join_runs, read_for_page
from isacbench.report.html.page_content import DEFAULT_METRIC, page_content
from isacbench.report.html.page_file import write_page

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from isacbench.bench.compare.comparison import Comparison
    from isacbench.report.html.joined_runs import ReadRun

RUN_PAGE = "report.html"
RANK_PAGE = "rank.html"
LEADERBOARD_PAGE = "leaderboard.html"
COMPARISON_PAGES = {False: "compare.html", True: "between.html"}
"""Name of the page of a comparison of runs, and of one of two estimators."""


def write_run_page(folder: Path, maps: Mapping[str, Any] | None = None, run: ReadRun | None = None) -> Path:
    """Write the page of a run into its folder.

    Parameters
    ----------
    folder : Path
        Of a run.
    maps : mapping of str to Any, optional
        As `isacbench.report.html.diagnosed_maps.diagnosed_maps` makes them.
    run : ReadRun, optional
        The run, where it is read already.

    Returns
    -------
    Path
        ``report.html`` in the folder, written anew.

    Raises
    ------
    InputError
        If the folder does not hold a run, or the page cannot be written.
    """
    joined = join_runs([run or read_for_page(folder)])
    content, clouds = page_content(joined)
    path = folder / RUN_PAGE
    write_page(path, f"{joined.runs[0].name} - isacbench", {**content, "maps": maps or {}}, clouds)
    return path


def write_rank_page(folder: Path, metric: str | None = None) -> Path:
    """Write the page of a ranking into the folder of its run.

    Parameters
    ----------
    folder : Path
        Of a run.
    metric : str, optional

    Returns
    -------
    Path
        ``rank.html`` in the folder.

    Raises
    ------
    InputError
        If the folder does not hold a run, or the page cannot be written.
    """
    joined = join_runs([read_for_page(folder)])
    content, clouds = page_content(joined, metric)
    path = folder / RANK_PAGE
    write_page(path, f"{joined.runs[0].name} ranked - isacbench", content, clouds)
    return path


def write_comparison_page(comparison: Comparison, folder: Path) -> Path:
    """Write the page of a comparison into the folder of the new run.

    Parameters
    ----------
    comparison : Comparison
    folder : Path

    Returns
    -------
    Path
        ``compare.html``, of two estimators of one run ``between.html``.

    Raises
    ------
    InputError
        If the folders do not hold the runs any more, or the page cannot be written.
    """
    is_between = comparison.between is not None
    paths = [Path(comparison.base)] if is_between else [Path(comparison.base), Path(comparison.new)]
    names = names_of(paths)
    if not is_between and len(set(names)) < 2:
        names = ["base", "new"]
    runs = [read_for_page(path, name) for path, name in zip(paths, names, strict=True)]
    joined = join_runs(runs, rename_all=True)
    compared, is_shown = compared_content(comparison, joined)
    metric = comparison.tolerances[0].metric if comparison.tolerances else DEFAULT_METRIC
    content, clouds = page_content(joined, metric, is_shown)
    path = folder / COMPARISON_PAGES[is_between]
    title = f"{' and '.join(names)} compared - isacbench"
    write_page(path, title, {**content, "comparison": compared}, clouds)
    return path


def write_leaderboard(folders: Sequence[Path], out: Path) -> Path:
    """Write one page of several runs of the same scenes.

    Parameters
    ----------
    folders : sequence of Path
        Runs of one suite, with the same seed, metric and scenes. SNRs and trials that not all of them have
        are left out.
    out : Path
        HTML file.

    Returns
    -------
    Path
        `out`.

    Raises
    ------
    InputError
        If two folders are the same, the runs measured different things, or the page cannot be written.
    """
    if len({folder.resolve() for folder in folders}) < len(folders):
        raise InputError("a folder is given twice; give different runs")
    runs = [read_for_page(folder, name) for folder, name in zip(folders, names_of(folders), strict=True)]
    joined = join_runs(runs, only_common=True)
    content, clouds = page_content(joined)
    write_page(out, f"{joined.table.manifest['suite']['name']}: leaderboard - isacbench", content, clouds)
    return out


def names_of(folders: Sequence[Path]) -> list[str]:
    """Name folders by their last part, or by their whole path where two share it.

    Parameters
    ----------
    folders : sequence of Path

    Returns
    -------
    list of str
        Different for different paths.

    Examples
    --------
    >>> names_of([Path("mine/new"), Path("old")]), names_of([Path("a/run"), Path("b/run")])
    (['new', 'old'], ['a/run', 'b/run'])
    """
    short = [folder.resolve().name for folder in folders]
    return short if len(set(short)) == len(short) else [str(folder) for folder in folders]
