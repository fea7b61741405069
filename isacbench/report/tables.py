"""Tables of a run: means with confidence bands, for the terminal, for a spreadsheet and for Markdown."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from isacbench.bench.statuses import failed
from isacbench.visible import in_markdown, visible

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from rich.table import Table

__all__ = [
    "HAUSDORFF_COLUMNS",
    "Grid",
    "Variant",
    "batched",
    "estimator_labels",
    "grids",
    "markdown",
    "rich_table",
    "summarise",
]

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
CONFIDENCE = 0.95
ESTIMATORS_A_TABLE = 4
LONGEST_LABEL = 24

Item = TypeVar("Item")
Variant = tuple[str, str]
"""Name and canonical parameters of an estimator."""


class Grid(NamedTuple):
    """A table of text: a title, the cells of its header, and rows of as many cells."""

    title: str
    header: list[str]
    rows: list[list[str]]


def summarise(records: pd.DataFrame) -> pd.DataFrame:
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
        that did not fail; and ``time_estimate_s_median`` of the same.
    """
    broken = failed(records)
    table = records.assign(
        hausdorff_sum_m=records[HAUSDORFF_COLUMNS].sum(axis=1, skipna=False),
        n_estimated=records["n_estimated"].where(~broken),
        no_detection=records["status"] == "no_detection",
        failed=broken,
        time_estimate_s=records["time_estimate_s"].where(~broken),
    )
    groups = table.groupby(GROUP, sort=False)
    mean, deviation, count = (getattr(groups[AVERAGED], name)() for name in ("mean", "std", "count"))
    # One trial has no band: Student's t with no degree of freedom is NaN.
    quantile = stdtrit(np.where(count > 1, count - 1, np.nan), (1 + CONFIDENCE) / 2)
    band = deviation * quantile / np.sqrt(count)
    columns: dict[str, pd.Series[Any]] = {
        "n_cells": groups.size(),
        "n_no_detection": groups["no_detection"].sum(),
        "n_failed": groups["failed"].sum(),
    }
    for name in AVERAGED:
        columns |= {f"{name}_mean": mean[name], f"{name}_band": band[name]}
    columns["time_estimate_s_median"] = groups["time_estimate_s"].median()
    return pd.DataFrame(columns).reset_index()


def estimator_labels(variants: Iterable[tuple[str, str]]) -> dict[tuple[str, str], str]:
    """Name estimators for people: the bare name, or with the parameters that set a variant of it apart.

    A value that more than half of the variants share goes without saying.

    Parameters
    ----------
    variants : iterable of (str, str)
        Names and canonical parameters, possibly repeated.

    Returns
    -------
    dict of (str, str) to str

    Examples
    --------
    >>> labels = estimator_labels([("a", '{"n":1}'), ("b", '{"n":1}'), ("b", '{"n":2}')])
    >>> list(labels.values())
    ['a', 'b[n=1]', 'b[n=2]']
    """
    distinct = dict.fromkeys(variants)
    labels = {}
    for name, params in distinct:
        own = json.loads(params)
        others = [json.loads(other) for other_name, other in distinct if other_name == name]
        labels[name, params] = name + _differing(own, others)
    return labels


def grids(records: pd.DataFrame) -> list[Grid]:
    """Lay out deviation, Hausdorff sum and time of a run, estimators over SNR.

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
    summary = summarise(records)
    labels = estimator_labels(zip(records["estimator"], records["params"], strict=True))
    return [
        _grid(str(scenario), part, labels, variants)
        for scenario, part in summary.groupby("scenario", sort=False)
        for variants in batched(
            dict.fromkeys(zip(part["estimator"], part["params"], strict=True)), ESTIMATORS_A_TABLE
        )
    ]


def rich_table(grid: Grid) -> Table:
    """Grid for the terminal."""
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
    for index, name in enumerate(grid.header):
        # Text, not a string: brackets are parameters and units here, never markup.
        table.add_column(
            Text(_stacked(visible(name))), justify="left" if index == 0 else "right", no_wrap=True
        )
    for row in grid.rows:
        table.add_row(*(Text(visible(cell)) for cell in row))
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


def _grid(
    scenario: str, part: pd.DataFrame, labels: Mapping[Variant, str], variants: Iterable[Variant]
) -> Grid:
    """Grid of one scenario: a row an SNR, a last row for the time; for each estimator two columns."""
    by_variant = {
        variant: part[(part["estimator"] == variant[0]) & (part["params"] == variant[1])].set_index("snr_db")
        for variant in variants
    }
    header = ["SNR [dB]"]
    for variant in by_variant:
        header += [f"{labels[variant]}: deviation", "Hausdorff [m]"]
    rows = []
    for snr_db in sorted(part["snr_db"].unique()):
        row = [f"{snr_db:g}"]
        for table in by_variant.values():
            row += _scores(table.loc[snr_db]) if snr_db in table.index else ["", ""]
        rows.append(row)
    times = ["time [ms]"]
    for table in by_variant.values():
        # Of NaN alone the median is NaN, but pandas before 3 warns of it.
        time_ms = 1e3 * table["time_estimate_s_median"].dropna().median()
        times += ["" if np.isnan(time_ms) else f"{time_ms:.1f}", ""]
    title = f"{scenario}: mean deviation ± 95 % band, mean Hausdorff sum, median time an image"
    return Grid(title, header, [*rows, times])


def _scores(entry: pd.Series[Any]) -> list[str]:
    """Two cells: the deviation with its band and what failed, and the Hausdorff sum."""
    if entry["n_failed"] == entry["n_cells"]:
        return [f"{entry['n_failed']} failed", ""]
    deviation = f"{entry['deviation_mean']:.2f}"
    if np.isfinite(entry["deviation_band"]):
        deviation += f" ±{entry['deviation_band']:.2f}"
    if entry["n_failed"]:
        deviation += f" ({entry['n_failed']} failed)"
    return [deviation, f"{entry['hausdorff_sum_m_mean']:.2f}"]


def _differing(own: Mapping[str, Any], others: Iterable[Mapping[str, Any]]) -> str:
    """Parameters that set these apart from most others, as a specification writes them."""
    others = list(others)
    texts = []
    for key, value in own.items():
        values = [other.get(key) for other in others]
        if key == "name" or 2 * values.count(value) > len(values):
            continue
        if isinstance(value, dict):
            namesakes = [
                other for other in values if isinstance(other, dict) and other["name"] == value["name"]
            ]
            texts.append(f"{key}={value['name']}{_differing(value, namesakes)}")
        else:
            texts.append(f"{key}={'none' if value is None else value}")
    return f"[{','.join(texts)}]" if texts else ""


def markdown(grid: Grid) -> str:
    """Grid as a Markdown table below its title."""
    rule = ["---"] + ["--:"] * (len(grid.header) - 1)
    header, *rows = ([in_markdown(cell) for cell in cells] for cells in (grid.header, *grid.rows))
    lines = [f"| {' | '.join(cells)} |" for cells in (header, rule, *rows)]
    return "\n".join([f"**{in_markdown(grid.title)}**", "", *lines, ""])
