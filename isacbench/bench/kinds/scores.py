"""Scores of images: means over trials and scenarios, ratios to the oracle, and tables of objects."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import pandas as pd

from isacbench import charts
from isacbench.bench.cells.record import COLUMNS, REFERENCE_COLUMNS, TIMING_COLUMNS, failed
from isacbench.bench.kinds.kind import SNR_GAIN
from isacbench.bench.statistics import means_and_bands, median_times
from isacbench.charts import VARIANT, Axis, Column, Table, Variant
from isacbench.files.escaping import counted
from isacbench.metrics.object_scores import ERRORS, UNITS
from isacbench.metrics.paper import PROJECTIONS
from isacbench.metrics.realisations import SPREAD_COLUMNS

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

SNR_AXIS = Axis("SNR [dB]")
Scale = Literal["share", "linear", "log"]

DETECTED = "detected_"
PERCENT = "{:.0f} %"


def averaged_columns(rows: pd.DataFrame) -> list[str]:
    """List the columns of rows that are averaged: scores of all metrics, and the number of points."""
    others = {*COLUMNS, *TIMING_COLUMNS, *REFERENCE_COLUMNS, *SNR_GAIN, *AVERAGED, *LONE_COUNTS}
    floats = rows.select_dtypes("float").columns
    return [*AVERAGED, *(name for name in floats if name not in others)]


def with_counts(rows: pd.DataFrame) -> pd.DataFrame:
    """Add what is counted of each row, `COUNTS`; failures have no number of points."""
    broken = failed(rows)
    return rows.assign(
        n_estimated=rows["n_estimated"].where(~broken),
        n_cells=1,
        n_no_detection=rows["status"] == "no_detection",
        n_failed=broken,
    )


def summarise_scores(rows: pd.DataFrame) -> pd.DataFrame:
    """Average the trials of every scenario, estimator and SNR.

    One row for each: the counts ``n_cells``, ``n_no_detection`` and ``n_failed``; for every score
    ``<score>_mean`` and ``<score>_band``, the half width of the 95 % confidence interval of the mean
    (Student's t), over the cells that did not fail, the band over five or more of them; of a reference the
    band is the mean spread over its realisations; and ``time_estimate_s_median`` as
    `isacbench.bench.statistics.median_times` has it.
    """
    groups, averaged = with_counts(rows).groupby(GROUP, sort=False), averaged_columns(rows)
    found = groups[COUNTS].sum().join(means_and_bands(groups, averaged))
    for name, spread in SPREAD_COLUMNS.items():
        if name in averaged and spread in rows:
            found[f"{name}_band"] = groups[spread].mean().fillna(found[f"{name}_band"])
    return found.join(median_times(rows, GROUP)).reset_index()


def average_scenarios(rows: pd.DataFrame) -> pd.DataFrame:
    """Average scores over scenarios, each of which counts once however many trials it has.

    As `summarise_scores`, one row for each estimator and SNR, with means and bands over the scenarios' means.
    ``scenario`` says how many there are, and counts are sums.
    """
    by, names = [*VARIANT, "snr_db"], averaged_columns(rows)
    groups = grouped_scenarios(with_counts(rows), by, names)
    found = groups[COUNTS].sum().join(means_and_bands(groups, names))
    found = found.join(median_times(rows, by)).reset_index()
    return found.assign(scenario=f"{rows['scenario'].nunique()} scenarios")


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


def score_axis(
    title: str, scale: Scale, table: pd.DataFrame, column: str, score: str, least: float = 0.0
) -> Axis:
    """Axis of a column of a score: of shares from 0 to 1, linear from 0, or logarithmic in whole decades."""
    if scale == "share":
        return Axis(title, limits=charts.SHARE_LIMITS)
    if scale == "linear":
        return Axis(title, limits=charts.linear_limits(table, column, score))
    return Axis(title, log=True, limits=charts.decades(table[column], least))


def mean_text(score: str, entry: Mapping[Any, Any]) -> str:
    """Mean of a score with its band."""
    mean = charts.number_or_blank(entry[f"{score}_mean"], "{:.2f}")
    return mean + charts.number_or_blank(entry[f"{score}_band"], " ±{:.2f}")


def labelled_rows(table: pd.DataFrame, labels: Mapping[Variant, str]) -> list[dict[Any, Any]]:
    """Rows of a table, one an estimator, in the order of the labels, each with its ``label``."""
    entries = {(entry["estimator"], entry["params"]): entry for entry in table.to_dict("records")}
    return [{**entries[one], "label": label} for one, label in labels.items() if one in entries]


def with_references(labels: Mapping[Variant, str], references: Collection[str]) -> dict[Variant, str]:
    """Mark the labels of the estimators that see the truth."""
    return {one: f"{label} (ref.)" if one[0] in references else label for one, label in labels.items()}


def object_tables(rows: pd.DataFrame, labels: Mapping[Variant, str]) -> list[Table]:
    """Objects of a run: shares that were detected, and errors, first over all SNRs, then as details at each.

    No tables if no row has scores of objects. Where some scenarios have no objects, the titles say so.
    """
    scored = rows[rows["n_objects"].notna()] if "n_objects" in rows else rows[:0]
    if scored.empty:
        return []
    without = [name for name in rows["scenario"].unique() if name not in set(scored["scenario"])]
    lack = f"; without {', '.join(without)}, whose points belong to no object" if without else ""
    title = f"Objects, {counted(scored['scenario'].nunique(), 'scene')}, "
    snrs_db = sorted(scored["snr_db"].unique())
    found = [_object_table(scored, labels, title + over_snrs(snrs_db) + lack)]
    for snr_db in snrs_db if len(snrs_db) > 1 else ():
        part = scored[scored["snr_db"] == snr_db]
        found.append(replace(_object_table(part, labels, f"{title}{snr_db:g} dB{lack}"), is_detail=True))
    return found


def over_snrs(snrs_db: list[float]) -> str:
    """Say which SNRs a mean is over."""
    listed = f"{', '.join(f'{snr_db:g}' for snr_db in snrs_db)} dB"
    return f"mean over {listed}" if len(snrs_db) > 1 else f"at {listed}"


def object_means(rows: pd.DataFrame) -> pd.DataFrame:
    """Means over scenes of all scores of objects by estimator; a scene counts once, whatever its images."""
    kinds = [name for name in map(str, rows) if name.startswith(DETECTED) and rows[name].notna().any()]
    errors = [f"objects_{error}_{unit}" for error, unit in ERRORS]
    columns = ["objects_f_score", "objects_detected", "n_objects_false", *kinds, *errors]
    scenes = rows.groupby([*VARIANT, "scenario"], sort=False)[columns].mean()
    return scenes.groupby(VARIANT, sort=False).mean()


def _object_table(rows: pd.DataFrame, labels: Mapping[Variant, str], title: str) -> Table:
    means = object_means(rows)
    columns = [
        Column("estimator", "label", part=0),
        Column("F-score", "objects_f_score", "{:.2f}"),
        Column("detected", "objects_detected", PERCENT, scale=100),
        Column("false: an image", "n_objects_false", "{:.2f}"),
    ]
    for kind in [name for name in map(str, means) if name.startswith(DETECTED)]:
        heading = kind.removeprefix(DETECTED).replace("_", " ")
        columns.append(Column(heading, kind, PERCENT, scale=100, optional=len(columns) - 2))
    least = len(columns) - 2
    for error, unit in ERRORS:
        heading, column = f"{error} [{UNITS[unit]}]", f"objects_{error}_{unit}"
        columns.append(Column(heading, column, "{:.2f}", optional=least))
    return Table(title, columns, labelled_rows(means.reset_index(), labels))
