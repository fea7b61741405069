"""Scores of images: how each is shown, means over trials and scenarios, and tables of objects."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import pandas as pd

from isacbench import charts
from isacbench.bench.cells.rows import COLUMNS, REFERENCE_COLUMNS, TIMING_COLUMNS, failed
from isacbench.bench.kinds.kind import SNR_GAIN
from isacbench.bench.statistics import means_and_bands, median_times
from isacbench.charts import VARIANT, Axis, Chart, Column, Line, Table, Variant
from isacbench.files.escaping import plural
from isacbench.metrics.object_scores import ERRORS, UNITS
from isacbench.metrics.paper import PROJECTIONS
from isacbench.metrics.realisations import SPREAD_COLUMNS


class Score(NamedTuple):
    """Number of an image in tables and charts.

    Attributes
    ----------
    name : str
        In headings and at axes, with its unit. Words after a colon stand below in a terminal.
    scale : {"linear", "share", "log"}
        Of its axis.
    form : str
        Of its mean in a table.
    optional : int
        How early a terminal without room leaves it out.
    is_higher_better : bool
    """

    name: str
    scale: Literal["linear", "share", "log"] = "linear"
    form: str = "{:.2f}"
    optional: int = 0
    is_higher_better: bool = False


SCORES = {
    "deviation": Score("imaging deviation"),
    "hausdorff_sum_m": Score("Hausdorff sum [m]"),
    "density": Score("density error", optional=4),
    "velocity_nmse": Score("velocity NMSE", "log", "{:.1e}", 4),
    "hausdorff_xy_m": Score("Hausdorff distance xy [m]"),
    "hausdorff_xz_m": Score("Hausdorff distance xz [m]"),
    "hausdorff_yz_m": Score("Hausdorff distance yz [m]"),
    "chamfer_m": Score("chamfer distance [m]"),
    "gospa_m": Score("GOSPA distance [m]"),
    "gospa_skill": Score("GOSPA skill", optional=1, is_higher_better=True),
    "velocity_error_mps": Score("velocity error [m/s]", optional=2),
    "f_score": Score("F-score", "share", is_higher_better=True),
    "objects_f_score": Score("objects: F-score", "share", optional=1, is_higher_better=True),
    "objects_detected": Score("objects detected", "share", is_higher_better=True),
    "n_objects_false": Score("false objects an image"),
    "precision": Score("precision", "share", optional=4, is_higher_better=True),
    "recall": Score("recall", "share", optional=3, is_higher_better=True),
}
"""Scores of images by their columns; others are shown under the names of theirs."""

GROUP = ["scenario", *VARIANT, "snr_db"]
COUNTS = ["n_cells", "n_no_detection", "n_failed"]
AVERAGED = [
    *("n_estimated", *PROJECTIONS, "hausdorff_sum_m", "density", "velocity_nmse", "deviation"),
    *("chamfer_m", "gospa_m", "precision", "recall"),
]

LONE_COUNTS = "n_resolvable", "n_resolved", "n_false"
"""Columns of a population that count something in families of lone scatterers alone."""

MANY_SCENARIOS = 12
"""More scenarios are not shown one by one, but by their mean."""

SMALLEST_ORACLE_M = 0.3
"""Least denominator of a ratio in m: the oracle of a scene of lone scatterers is 0."""

POINT_FAMILIES = ("sparse",)
"""Families without ratios: their targets are absolute."""

PRACTICALLY_ZERO = 1e-6
"""Smaller means do not stretch a logarithmic axis: such velocities are exact for any purpose."""

SNR_AXIS = Axis("SNR [dB]")

DETECTED = "detected_"
PERCENT = "{:.0f} %"


def averaged_columns(rows: pd.DataFrame) -> list[str]:
    """List the columns of rows that are averaged: scores, the number of points, and numbers of the kind."""
    others = {*COLUMNS, *TIMING_COLUMNS, *REFERENCE_COLUMNS, *SNR_GAIN, *AVERAGED, *LONE_COUNTS}
    return [*AVERAGED, *(name for name in map(str, rows.select_dtypes("number")) if name not in others)]


def with_counts(rows: pd.DataFrame) -> pd.DataFrame:
    """Add what is counted of each row, `COUNTS`; failures have nothing that is averaged."""
    broken, names = failed(rows), averaged_columns(rows)
    numbers = rows[names].mask(broken, axis=0)
    table = pd.concat([rows.drop(columns=names), numbers], axis=1)  # in one piece
    return table.assign(n_cells=1, n_no_detection=rows["status"] == "no_detection", n_failed=broken)


def summarise_scores(rows: pd.DataFrame) -> pd.DataFrame:
    """Average the trials of every scenario, estimator and SNR.

    One row for each: the counts ``n_cells``, ``n_no_detection`` and ``n_failed``; for every score
    ``<score>_mean`` and ``<score>_band``, the half width of the 95 % confidence interval of the mean
    (Student's t), over the cells that did not fail, the band over five or more of them; of a reference the
    band is the mean spread over its realisations; and ``time_estimate_s_median`` as
    `isacbench.bench.statistics.median_times` has it.
    """
    groups, averaged = with_counts(rows).groupby(GROUP, sort=False), averaged_columns(rows)
    summary = groups[COUNTS].sum().join(means_and_bands(groups, averaged))
    for name, spread in SPREAD_COLUMNS.items():
        if name in averaged and spread in rows:
            summary[f"{name}_band"] = groups[spread].mean().fillna(summary[f"{name}_band"])
    return summary.join(median_times(rows, GROUP)).reset_index()


def average_scenarios(rows: pd.DataFrame) -> pd.DataFrame:
    """Average scores over scenarios, each of which counts once however many trials it has.

    As `summarise_scores`, one row for each estimator and SNR, with means and bands over the scenarios' means.
    ``scenario`` says how many there are, and counts are sums.
    """
    by, names = [*VARIANT, "snr_db"], averaged_columns(rows)
    groups = grouped_scenarios(with_counts(rows), by, names)
    summary = groups[COUNTS].sum().join(means_and_bands(groups, names))
    summary = summary.join(median_times(rows, by)).reset_index()
    return summary.assign(scenario=f"{rows['scenario'].nunique()} scenarios")


def grouped_scenarios(rows: pd.DataFrame, by: Sequence[str], names: Sequence[str]) -> Any:
    """Group the scenarios of rows with counts: the sums of their counts, and their means of some columns."""
    cells = rows.groupby([*by, "scenario"], sort=False, dropna=False)
    scenarios = cells[COUNTS].sum().join(cells[[*names]].mean()).reset_index()
    return scenarios.groupby([*by], sort=False, dropna=False)


def hausdorff_ratios(rows: pd.DataFrame, without: Collection[str] = ()) -> pd.Series[float]:
    """Divide the Hausdorff sum of each row by that of the oracle at the same scenario, SNR and trial.

    Scenarios `without` get none, such as those of `POINT_FAMILIES`. NaN without scores or without a row of
    the oracle; the denominator is at least `SMALLEST_ORACLE_M`.
    """
    keys = ["scenario", "snr_db", "trial"]
    cell = rows["params"].map(lambda params: json.loads(params or "{}").get("cell", 1.0))
    oracle = rows[(rows["estimator"] == "oracle") & (cell == 1)]
    oracle_m = oracle.groupby(keys)["hausdorff_sum_m"].mean().clip(lower=SMALLEST_ORACLE_M)
    denominator_m = oracle_m.reindex(pd.MultiIndex.from_frame(rows[keys])).set_axis(rows.index)
    return (rows["hausdorff_sum_m"] / denominator_m).where(~rows["scenario"].isin(list(without)))


def score_of(column: str) -> Score:
    """Look up how a column of images is shown; one without an entry has its own name, and all its digits."""
    return SCORES.get(column, Score(column, form="{:.4g}"))


def score_chart(
    title: str,
    one: Score,
    column: str,
    table: pd.DataFrame,
    lines: Mapping[Variant, Line],
    scaling: pd.DataFrame,
) -> Chart:
    """Mean or median of a score over SNR: of shares from 0 to 1, linear from 0, or in whole decades.

    A linear axis has room for all of `scaling`, the `table` itself or one that it is a part of.
    """
    stem = column.removesuffix("_mean").removesuffix("_median")
    if one.scale == "share":
        y = Axis(one.name, limits=charts.SHARE_LIMITS)
    elif one.scale == "linear":
        y = Axis(one.name, limits=charts.linear_limits(scaling, column, stem))
    else:
        y = Axis(one.name, log=True, limits=charts.decades(table[column], PRACTICALLY_ZERO))
    return Chart(title, SNR_AXIS, y, charts.line_series(table, lines, "snr_db", column, stem))


def mean_text(column: str, entry: Mapping[Any, Any]) -> str:
    """Mean of a score with its band, or a median, which has none."""
    band = entry.get(f"{column.removesuffix('_mean')}_band", math.nan)
    return charts.number_or_blank(entry[column], "{:.2f}") + charts.number_or_blank(band, " ±{:.2f}")


def labelled_rows(rows: Iterable[Mapping[Any, Any]], labels: Mapping[Variant, str]) -> list[dict[Any, Any]]:
    """Rows of a table, one an estimator, in the order of the labels, each with its ``label``."""
    entries = {(row["estimator"], row["params"]): row for row in rows}
    return [{**entries[one], "label": label} for one, label in labels.items() if one in entries]


def with_references(labels: Mapping[Variant, str], references: Collection[str]) -> dict[Variant, str]:
    """Mark the labels of the estimators that see the truth."""
    return {one: f"{label} (ref.)" if one[0] in references else label for one, label in labels.items()}


def over_snrs(rows: pd.DataFrame) -> str:
    """Say which SNRs a mean is over, or that there is one."""
    snrs_db = sorted(rows["snr_db"].unique())
    return f"{'mean over' if len(snrs_db) > 1 else 'at'} {', '.join(f'{snr_db:g}' for snr_db in snrs_db)} dB"


def object_means(rows: pd.DataFrame) -> pd.DataFrame:
    """Means over scenes of all scores of objects by estimator; a scene counts once, whatever its images."""
    kinds = [name for name in map(str, rows) if name.startswith(DETECTED) and rows[name].notna().any()]
    errors = [f"objects_{error}_{unit}" for error, unit in ERRORS]
    columns = ["objects_f_score", "objects_detected", "n_objects_false", *kinds, *errors]
    scenes = rows.groupby([*VARIANT, "scenario"], sort=False)[columns].mean()
    return scenes.groupby(VARIANT, sort=False).mean()


def object_tables(rows: pd.DataFrame, labels: Mapping[Variant, str]) -> list[Table]:
    """Objects of a run: shares that were detected, and errors, over all SNRs; nothing if no row has any."""
    scored = rows[rows["n_objects"].notna()] if "n_objects" in rows else rows[:0]
    if scored.empty:
        return []
    means = object_means(scored)
    columns = [
        Column("estimator", "label", part=0),
        Column("F-score", "objects_f_score", "{:.2f}"),
        Column("detected", "objects_detected", PERCENT, scale=100),
        Column("false: an image", "n_objects_false", "{:.2f}"),
    ]
    for number, kind in enumerate((name for name in map(str, means) if name.startswith(DETECTED)), start=2):
        heading = kind.removeprefix(DETECTED).replace("_", " ")
        columns.append(Column(heading, kind, PERCENT, scale=100, optional=number))
    for error, unit in ERRORS:
        heading, column = f"{error} [{UNITS[unit]}]", f"objects_{error}_{unit}"
        columns.append(Column(heading, column, "{:.2f}", optional=1))
    title = f"Objects, {plural(scored['scenario'].nunique(), 'scene')}, {over_snrs(scored)}"
    return [Table(title, columns, labelled_rows(means.reset_index().to_dict("records"), labels))]
