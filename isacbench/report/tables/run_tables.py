"""Tables of a run as text: scores of images, and what the tables of all kinds of suites have in common."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import pandas as pd

from isacbench.bench.studies.intervals import MIN_TRIALS
from isacbench.files.escaping import in_markdown, visible

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from rich.table import Table


TERMINAL_WIDTH = 100
LONGEST_LABEL = 24

Item = TypeVar("Item")


class Grid(NamedTuple):
    """A table of text.

    Attributes
    ----------
    title : str
    header : list of str
    rows : list of list of str
        Each with as many cells as the header.
    spare : sequence of list of int
        Groups of columns that a terminal leaves out where the table is wider than 100 characters,
        the last group first.
    is_detail : bool
        True for a table that is written into files, and not printed.
    """

    title: str
    header: list[str]
    rows: list[list[str]]
    spare: Sequence[Sequence[int]] = ()
    is_detail: bool = False


def trials_and_band(n_trials: int, noun: str = "band") -> str:
    """Say how many trials there were, and whether they have a confidence band.

    Parameters
    ----------
    n_trials : int
    noun : str
        ``"band"`` or ``"interval"``.

    Returns
    -------
    str

    Examples
    --------
    >>> trials_and_band(12), trials_and_band(2, "interval")
    ('12 trials, 95 % confidence band', '2 trials, no confidence interval below 5')
    """
    trials = "1 trial" if n_trials == 1 else f"{n_trials} trials"
    if n_trials < MIN_TRIALS:
        return f"{trials}, no confidence {noun} below {MIN_TRIALS}"
    return f"{trials}, 95 % confidence {noun}"


def mean_of_trials(n_trials: int) -> str:
    """Say that something is a mean over trials, unless there is but one.

    Parameters
    ----------
    n_trials : int

    Returns
    -------
    str

    Examples
    --------
    >>> mean_of_trials(5), mean_of_trials(1)
    ('mean of 5 trials, 95 % confidence band', 'one trial')
    """
    return "one trial" if n_trials == 1 else f"mean of {trials_and_band(n_trials)}"


def milliseconds(time_s: float, digits: int = 1) -> str:
    """Write a time in milliseconds, nothing where there is none.

    Parameters
    ----------
    time_s : float
        In s, or NaN.
    digits : int
        Decimals.

    Returns
    -------
    str

    Examples
    --------
    >>> milliseconds(0.01234), milliseconds(0.01234, digits=2), milliseconds(float("nan"))
    ('12.3', '12.34', '')
    """
    return "" if math.isnan(time_s) else f"{1e3 * time_s:.{digits}f}"


def mean_of_scenarios(n_scenarios: int) -> str:
    """Say that something is a mean over scenarios, and whether it has a confidence band.

    Parameters
    ----------
    n_scenarios : int

    Returns
    -------
    str

    Examples
    --------
    >>> mean_of_scenarios(100)
    'mean over 100 scenarios, 95 % confidence band'
    """
    band = "95 % confidence band" if n_scenarios >= MIN_TRIALS else f"no confidence band below {MIN_TRIALS}"
    return f"mean over {n_scenarios} scenarios, {band}"


def written(value: float, form: str) -> str:
    """Write a number, nothing where there is none.

    Parameters
    ----------
    value : float
    form : str
        Format of the number, such as ``"{:.2f}"``.

    Returns
    -------
    str
        Empty of NaN.
    """
    return "" if math.isnan(value) else form.format(value)


def with_failures(text: str, n_failed: int) -> str:
    """Add the number of failed cells to a text, if there are any.

    Parameters
    ----------
    text : str
    n_failed : int

    Returns
    -------
    str

    Examples
    --------
    >>> with_failures("0.12", 0), with_failures("0.12", 2), with_failures("", 2)
    ('0.12', '0.12 (2 failed)', '2 failed')
    """
    if not n_failed:
        return text
    return f"{text} ({n_failed} failed)" if text else f"{n_failed} failed"


def text_rows(
    part: pd.DataFrame,
    rows: list[str],
    columns: list[str],
    write: Callable[[pd.Series[Any]], str],
) -> pd.DataFrame:
    """Spread a summary over rows and columns of texts.

    Parameters
    ----------
    part : DataFrame
        Summary.
    rows, columns : list of str
        Columns of the summary whose values become rows and columns, in the order of their first
        occurrence.
    write : callable
        From a row of the summary to its text.

    Returns
    -------
    DataFrame of str
        Empty texts where the summary has no row.
    """
    texts = part[[*rows, *columns]].assign(text=[write(entry) for _, entry in part.iterrows()])
    return texts.pivot_table("text", rows, columns, aggfunc="first", sort=False).fillna("")


def batched(items: Iterable[Item], n: int) -> list[list[Item]]:
    """Cut a list into parts.

    Parameters
    ----------
    items : iterable
    n : int
        Most items of a part.

    Returns
    -------
    list of list
    """
    listed = list(items)
    return [listed[start : start + n] for start in range(0, len(listed), n)]


def rich_table(grid: Grid) -> Table:
    """Lay out a grid for the terminal, without the spare columns for which 100 characters have no room.

    Parameters
    ----------
    grid : Grid

    Returns
    -------
    Table
        Of rich.
    """
    from rich.console import Console

    ruler = Console(width=10 * TERMINAL_WIDTH)
    for n_kept in reversed(range(1 + len(grid.spare))):
        left_out = {column for group in grid.spare[n_kept:] for column in group}
        table = _columns_table(grid, [place for place in range(len(grid.header)) if place not in left_out])
        if ruler.measure(table).maximum <= TERMINAL_WIDTH:
            break
    return table


def _columns_table(grid: Grid, columns: Sequence[int]) -> Table:
    """Some columns of a grid for the terminal."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    table = Table(
        title=Text(visible(grid.title)),
        title_justify="left",
        box=SIMPLE_HEAD,
        pad_edge=False,
        collapse_padding=True,
    )
    for index in columns:
        # Text, not a string: brackets are parameters and units here, never markup.
        table.add_column(
            Text(_stacked(visible(grid.header[index]))),
            justify="left" if index == 0 else "right",
            no_wrap=True,
        )
    for row in grid.rows:
        # Of a pair of estimators, the second one stands below the first.
        table.add_row(*(Text(visible(row[index]).replace(" → ", "\n  → ")) for index in columns))
    return table


def _stacked(name: str) -> str:
    """Column name on several lines: unit and score below, and long parameters one bracket a line."""
    label, *below = name.replace(" [", ": [").split(": ")
    if len(label) > LONGEST_LABEL:
        label = label.replace("[", "\n[")
    return "\n".join([label, *below])


def markdown(grid: Grid) -> str:
    """Write a grid as a Markdown table below its title.

    Parameters
    ----------
    grid : Grid

    Returns
    -------
    str
    """
    rule = ["---"] + ["--:"] * (len(grid.header) - 1)
    header, *rows = ([in_markdown(cell) for cell in cells] for cells in (grid.header, *grid.rows))
    lines = [f"| {' | '.join(cells)} |" for cells in (header, rule, *rows)]
    return "\n".join([f"**{in_markdown(grid.title)}**", "", *lines, ""])
