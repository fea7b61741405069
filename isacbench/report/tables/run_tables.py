"""Tables of a run: means with confidence bands, for the terminal, for a spreadsheet and for Markdown."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
import pandas as pd

from isacbench.bench.cells.statuses import failed
from isacbench.bench.plan.labels import Variant, estimator_labels
from isacbench.bench.studies.intervals import MIN_TRIALS, student_band
from isacbench.bench.studies.medians import TIME, median_times
from isacbench.files.escaping import in_markdown, visible

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from rich.table import Table

GROUP = ["scenario", "estimator", "params", "snr_db"]
HAUSDORFF_COLUMNS = ["hausdorff_xy_m", "hausdorff_xz_m", "hausdorff_yz_m"]
AVERAGED = [
    "n_estimated",
    *HAUSDORFF_COLUMNS,
    "hausdorff_sum_m",
    "density",
    "velocity_nmse",
    "deviation",
    "chamfer_m",
    "gospa_m",
    "precision",
    "recall",
]
SHOWN = {
    "hausdorff_sum_m": "Hausdorff [m]",
    "gospa_m": "GOSPA [m]",
    "precision": "precision",
    "recall": "recall",
}
"""Scores that a table shows after the deviation, with their headings."""

SPARE = ("gospa_m",), ("precision", "recall")
"""Those that a terminal has where there is room, the last ones first left out."""

TERMINAL_WIDTH = 100
ESTIMATORS_A_TABLE = 4
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
    """

    title: str
    header: list[str]
    rows: list[list[str]]
    spare: Sequence[Sequence[int]] = ()


def summarise_scores(records: pd.DataFrame) -> pd.DataFrame:
    """Average the trials of every scenario, estimator and SNR.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.

    Returns
    -------
    DataFrame
        One row for each scenario, estimator (with its parameters) and SNR:
        the counts ``n_cells``, ``n_no_detection`` and ``n_failed``; for every
        score ``<score>_mean`` and ``<score>_band``, the half width of the
        95 % confidence interval of the mean (Student's t), over the cells
        that did not fail, the band over five or more of them; and
        ``time_estimate_s_median`` as `isacbench.bench.studies.medians.median_times`
        has it.
    """
    broken = failed(records)
    table = records.assign(
        hausdorff_sum_m=records[HAUSDORFF_COLUMNS].sum(axis=1, skipna=False),
        n_estimated=records["n_estimated"].where(~broken),
        no_detection=records["status"] == "no_detection",
        failed=broken,
    )
    groups = table.groupby(GROUP, sort=False)
    mean, deviation, count = (getattr(groups[AVERAGED], name)() for name in ("mean", "std", "count"))
    band = pd.DataFrame(student_band(deviation, count), index=mean.index, columns=AVERAGED)
    columns: dict[str, pd.Series[Any]] = {
        "n_cells": groups.size(),
        "n_no_detection": groups["no_detection"].sum(),
        "n_failed": groups["failed"].sum(),
    }
    for name in AVERAGED:
        columns |= {f"{name}_mean": mean[name], f"{name}_band": band[name]}
    return pd.DataFrame(columns).join(median_times(records, GROUP)).reset_index()


def trials_and_band(n_trials: int, noun: str = "band") -> str:
    """Say how many trials there were, and whether they have a confidence band or interval.

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

    Examples
    --------
    >>> mean_of_trials(5), mean_of_trials(1)
    ('mean of 5 trials, 95 % confidence band', 'one trial')
    """
    return "one trial" if n_trials == 1 else f"mean of {trials_and_band(n_trials)}"


def milliseconds(time_s: float, digits: int = 1) -> str:
    """Write a time in milliseconds, nothing where there is none (NaN).

    Examples
    --------
    >>> milliseconds(0.01234), milliseconds(0.01234, digits=2), milliseconds(float("nan"))
    ('12.3', '12.34', '')
    """
    return "" if math.isnan(time_s) else f"{1e3 * time_s:.{digits}f}"


def grids(records: pd.DataFrame) -> list[Grid]:
    """Lay out scores and times of a run, estimators over SNR.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.

    Returns
    -------
    list of Grid
        One a scenario, or more where the estimators are too many for the
        width of a terminal.
    """
    summary = summarise_scores(records)
    times_s = median_times(records, ["scenario", "estimator", "params"])[f"{TIME}_median"]
    labels = estimator_labels(zip(records["estimator"], records["params"], strict=True))
    found = []
    for scenario, part in summary.groupby("scenario", sort=False):
        variants = dict.fromkeys(zip(part["estimator"], part["params"], strict=True))
        for batch in batched(variants, ESTIMATORS_A_TABLE):
            times = [milliseconds(times_s.get((scenario, *variant), np.nan)) for variant in batch]
            found.append(_grid(str(scenario), part, {variant: labels[variant] for variant in batch}, times))
    return found


def rich_table(grid: Grid) -> Table:
    """Grid for the terminal, without the spare columns for which 100 characters have no room."""
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


def batched(items: Iterable[Item], n: int) -> list[list[Item]]:
    """Cut a list into parts of at most `n`."""
    listed = list(items)
    return [listed[start : start + n] for start in range(0, len(listed), n)]


def _grid(scenario: str, part: pd.DataFrame, labels: Mapping[Variant, str], times: Sequence[str]) -> Grid:
    """Grid of one scenario: a row an SNR, a last row for the time; for each estimator a column a score."""
    by_variant = [
        part[(part["estimator"] == name) & (part["params"] == params)].set_index("snr_db")
        for name, params in labels
    ]
    nothing = [""] * len(SHOWN)
    header, last = ["SNR [dB]"], ["time [ms]"]
    for label, time_ms in zip(labels.values(), times, strict=True):
        header += [f"{label}: deviation", *SHOWN.values()]
        last += [time_ms, *nothing]
    rows = []
    for snr_db in sorted(part["snr_db"].unique()):
        row = [f"{snr_db:g}"]
        for table in by_variant:
            row += _scores(table.loc[snr_db]) if snr_db in table.index else ["", *nothing]
        rows.append(row)
    title = f"{scenario}: {mean_of_trials(int(part['n_cells'].max()))}; median time of an image"
    spare = [
        [place for place, name in enumerate(header) if name in {SHOWN[score] for score in group}]
        for group in SPARE
    ]
    return Grid(title, header, [*rows, last], spare)


def _scores(entry: pd.Series[Any]) -> list[str]:
    """Cells of one estimator at one SNR: the deviation with its band and what failed, and further scores."""
    if entry["n_failed"] == entry["n_cells"]:
        return [f"{entry['n_failed']} failed", *[""] * len(SHOWN)]
    deviation = f"{entry['deviation_mean']:.2f}"
    if np.isfinite(entry["deviation_band"]):
        deviation += f" ±{entry['deviation_band']:.2f}"
    if entry["n_failed"]:
        deviation += f" ({entry['n_failed']} failed)"
    return [deviation, *(_mean(entry[f"{score}_mean"]) for score in SHOWN)]


def _mean(value: float) -> str:
    """Mean of a score in words; nothing where no row has the score."""
    return "" if math.isnan(value) else f"{value:.2f}"


def markdown(grid: Grid) -> str:
    """Grid as a Markdown table below its title."""
    rule = ["---"] + ["--:"] * (len(grid.header) - 1)
    header, *rows = ([in_markdown(cell) for cell in cells] for cells in (grid.header, *grid.rows))
    lines = [f"| {' | '.join(cells)} |" for cells in (header, rule, *rows)]
    return "\n".join([f"**{in_markdown(grid.title)}**", "", *lines, ""])
