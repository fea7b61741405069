"""Tables of a population: every estimator over all scenes, by family, by frame and phases."""

from __future__ import annotations

import json
import math
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from isacbench.bench.plan.labels import estimator_labels, find_limits, variants_in
from isacbench.bench.studies.intervals import MIN_TRIALS
from isacbench.bench.studies.medians import time_words
from isacbench.bench.studies.population_study import ALL, PART, PHASES, TARGETS, summarise_population
from isacbench.report.tables.detected_objects import object_grids
from isacbench.report.tables.run_tables import Grid, milliseconds, with_failures, written

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from isacbench.bench.plan.labels import Variant

NEAR = 0.2
"""Relative distance to the median estimator within which a baseline comes near it."""

BASELINES = "chance", "empty"
"""References without skill: random points, and none."""

MARK = " †"


class _Shown(NamedTuple):
    """Number of a table: its heading, its column of the summary, and how it is written."""

    heading: str
    column: str
    form: str
    is_higher_better: bool = False


RATIO = _Shown("median: ratio", "ratio_median", "{:.2f}")
HAUSDORFF = _Shown("Hausdorff [m]", "hausdorff_sum_m_mean", "{:.2f}")
SHOWN = (
    RATIO,
    HAUSDORFF,
    _Shown("F-score", "f_score_mean", "{:.2f}", is_higher_better=True),
    _Shown("objects: F-score", "objects_f_score_mean", "{:.2f}", is_higher_better=True),
    _Shown("GOSPA: skill", "gospa_skill_mean", "{:.2f}", is_higher_better=True),
    _Shown("velocity: error [m/s]", "velocity_error_mps_mean", "{:.2f}"),
    _Shown("precision", "precision_mean", "{:.2f}", is_higher_better=True),
    _Shown("recall", "recall_mean", "{:.2f}", is_higher_better=True),
)
AIMED = (
    _Shown("false points: an image", "n_false_mean", "{:.2f}"),
    _Shown("images: without any", "share_clean_mean", "{:.2f}", is_higher_better=True),
    _Shown("scatterers: resolved", "share_resolved_mean", "{:.2f}", is_higher_better=True),
    _Shown("images: all met", "share_met_mean", "{:.2f}", is_higher_better=True),
)
FURTHER = _Shown("deviation", "deviation_mean", "{:.2f}")
JUDGED = (*SHOWN, FURTHER, *AIMED)
SPARE = ["precision", "recall", "velocity: error [m/s]", "GOSPA: skill"]
"""Columns that a terminal shows where there is room, the first ones left out first."""


def tabulate_population(records: pd.DataFrame) -> pd.DataFrame:
    """Summarise a population, and mark the numbers in which a baseline comes near the estimators.

    Parameters
    ----------
    records : DataFrame
        Rows of a run of the kind ``population``.

    Returns
    -------
    DataFrame
        As `isacbench.bench.studies.population_study.summarise_population` returns it, with the
        further columns ``sees_truth`` and ``near_chance``, the names of the marked columns as JSON:
        the better one of `chance` and `empty` is better than, or within 20 % of, the median of the
        estimators that do not see the truth.
    """
    summary = summarise_population(records)
    summary = summary.copy().assign(sees_truth=summary["estimator"].isin(find_limits(records)))
    marked = {
        key: json.dumps(near_chance(part)) for key, part in summary.groupby(PART, sort=False, dropna=False)
    }
    near = pd.Series(marked).rename_axis(PART).rename("near_chance")
    return summary.merge(near.reset_index(), how="left", on=PART)


def near_chance(part: pd.DataFrame) -> list[str]:
    """Find the numbers in which the better one of the baselines comes near the estimators of some scenes.

    Parameters
    ----------
    part : DataFrame
        Rows of the summary with ``sees_truth``, one an estimator.

    Returns
    -------
    list of str
        Columns of the summary.
    """
    judged = [one for one in JUDGED if one.column in part]
    columns = [one.column for one in judged]
    is_baseline = part["estimator"].isin(BASELINES)
    typical = part.loc[~is_baseline & ~part["sees_truth"], columns].median().to_numpy()
    higher = np.array([one.is_higher_better for one in judged])
    found = part.loc[is_baseline, columns]
    guessed = np.where(higher, found.max().to_numpy(), found.min().to_numpy())
    # Without either number nothing is near.
    is_near = np.where(higher, guessed >= (1 - NEAR) * typical, guessed <= (1 + NEAR) * typical)
    return [column for column, near in zip(columns, is_near, strict=True) if near]


def population_grids(records: pd.DataFrame) -> list[Grid]:
    """Lay out a population: all scenes, ratios by family and by frame and phases, lone scatterers.

    Parameters
    ----------
    records : DataFrame
        Rows of a run of the kind ``population``.

    Returns
    -------
    list of Grid
        Last, and not for the terminal, each family on its own, over all SNRs and at each.
    """
    summary = tabulate_population(records)
    labels = _row_labels(summary)
    snrs_db = sorted(summary["snr_db"].dropna().unique())
    over_snrs = f"{', '.join(f'{snr_db:g}' for snr_db in snrs_db)} dB"
    over_snrs = f"mean over {over_snrs}" if len(snrs_db) > 1 else f"at {over_snrs}"
    # A heading of all tables of scores: times of cells that ran beside others mislead.
    words = "time [ms]" + time_words(records).removeprefix("median processor time")
    found = [_score_grid(_part(summary), labels, f"All scenes, {over_snrs}", words)]
    families = [name for name in summary["family"].unique() if name != ALL]
    lone = [name for name in families if _part(summary, name)[f"{TARGETS[0]}_mean"].notna().any()]
    scattered = {name: _part(summary, name) for name in families if name not in lone}
    found += _ratio_grid(scattered, labels, f"Median ratio by family, {over_snrs}")
    conditions = {
        f"{frame}, {phases}": _part(summary, ALL, frame, phases)
        for frame, phases in product(("panel", "paper"), PHASES.values())
    }
    found += _ratio_grid(conditions, labels, f"Median ratio by frame and phases, {over_snrs}")
    found += [_target_grid(_part(summary, name), labels, f"{name}, {over_snrs}") for name in lone]
    found += object_grids(records, labels)
    for name, snr_db in product((ALL, *families), (math.nan, *snrs_db)):
        part = _part(summary, name, snr_db=snr_db)
        if part.empty:  # the run was interrupted before
            continue
        heading = over_snrs if math.isnan(snr_db) else f"{snr_db:g} dB"
        title = f"{'All scenes' if name == ALL else name}, {heading}"
        if (name, heading) != (ALL, over_snrs):
            found.append(_score_grid(part, labels, title, words)._replace(is_detail=True))
        if name in lone and heading != over_snrs:
            found.append(_target_grid(part, labels, title)._replace(is_detail=True))
    return found


def _part(
    summary: pd.DataFrame,
    family: str = ALL,
    frame: str = ALL,
    phases: str = ALL,
    snr_db: float = math.nan,
) -> pd.DataFrame:
    """Rows of some scenes at one SNR, or over all SNRs."""
    is_snr = summary["snr_db"].isna() if math.isnan(snr_db) else summary["snr_db"] == snr_db
    chosen = (summary["family"] == family) & (summary["frame"] == frame) & (summary["phases"] == phases)
    return summary[is_snr & chosen]


def _entries(part: pd.DataFrame, labels: Mapping[Variant, str]) -> dict[Variant, pd.Series[Any]]:
    """Rows of a part by estimator, in the order of the labels."""
    found = {(entry["estimator"], entry["params"]): entry for _, entry in part.iterrows()}
    return {variant: found[variant] for variant in labels if variant in found}


def _row_labels(summary: pd.DataFrame) -> dict[Variant, str]:
    """Labels of the estimators, then of the references that see the truth."""
    labels = estimator_labels(variants_in(summary))
    references = set(variants_in(summary[summary["sees_truth"]]))
    ordered = sorted(labels, key=lambda variant: variant in references)
    return {one: f"{labels[one]} (ref.)" if one in references else labels[one] for one in ordered}


def _score_grid(part: pd.DataFrame, labels: Mapping[Variant, str], title: str, words: str) -> Grid:
    """Scores of some scenes, a row an estimator."""
    # Where all cells failed, an empty column has their number.
    shown = [one for one in SHOWN if one.column in part and part[one.column].notna().any()] or [HAUSDORFF]
    marked = _marked(part)
    header = ["estimator", *(one.heading + _mark(one, marked) for one in shown), words]
    rows = []
    for variant, entry in _entries(part, labels).items():
        cells = [_number(entry, one) for one in shown]
        cells[0] = with_failures(cells[0], int(entry["n_failed"]))
        rows.append([labels[variant], *cells, milliseconds(entry["time_estimate_s_median"])])
    spare = [
        [place for place, one in enumerate(shown, start=1) if one.heading == name] for name in SPARE[::-1]
    ]
    return Grid(_titled(part, title, header), header, rows, spare)


def _ratio_grid(parts: dict[str, pd.DataFrame], labels: Mapping[Variant, str], title: str) -> list[Grid]:
    """Median ratios with quartiles, a column for each of some parts; nothing where there are none."""
    shown = {name: part for name, part in parts.items() if part["ratio_median"].notna().any()}
    if len(shown) < 2:
        return []
    header = ["estimator", *(f"{name}{_mark(RATIO, _marked(part))}" for name, part in shown.items())]
    columns = [_entries(part, labels) for part in shown.values()]
    rows = [
        [label, *(_ratio(column[variant]) if variant in column else "" for column in columns)]
        for variant, label in labels.items()
    ]
    return [Grid(_noted(f"{title} (quartiles)", header), header, rows)]


def _target_grid(part: pd.DataFrame, labels: Mapping[Variant, str], title: str) -> Grid:
    """Absolute targets of lone scatterers, a row an estimator."""
    marked = _marked(part)
    header = ["estimator", *(f"{one.heading}{_mark(one, marked)}" for one in AIMED)]
    rows = [
        [labels[variant], *(_number(entry, one) for one in AIMED)]
        for variant, entry in _entries(part, labels).items()
    ]
    return Grid(_titled(part, f"Targets of {title}", header), header, rows)


def _titled(part: pd.DataFrame, title: str, header: Sequence[str]) -> str:
    """Title with the number of scenes, which decides whether there are bands."""
    n_scenes = int(part["n_scenes"].max())
    scenes = "1 scene" if n_scenes == 1 else f"{n_scenes} scenes"
    band = "95 % confidence band" if n_scenes >= MIN_TRIALS else f"no confidence band below {MIN_TRIALS}"
    return _noted(f"{title}: {scenes}, {band}", header)


def _noted(title: str, header: Sequence[str]) -> str:
    """Title that explains the mark where a heading has it."""
    return (
        f"{title}; †: chance or no point at all comes near"
        if any(name.endswith(MARK) for name in header)
        else title
    )


def _marked(part: pd.DataFrame) -> Collection[str]:
    """Columns in which chance comes near; the same for all rows of a part."""
    marked: list[str] = json.loads(part["near_chance"].iloc[0]) if len(part) else []
    return marked


def _mark(one: _Shown, marked: Collection[str]) -> str:
    return MARK if one.column in marked else ""


def _number(entry: pd.Series[Any], one: _Shown) -> str:
    """Number of one estimator, a mean with its band."""
    text = written(entry[one.column], one.form)
    stem = one.column.removesuffix("_mean")
    if stem == one.column:
        return text
    return text + written(entry[f"{stem}_band"], f" ±{one.form}")


def _ratio(entry: pd.Series[Any]) -> str:
    """Median ratio and its quartiles."""
    middle, low, high = (written(entry[f"ratio_{name}"], "{:.2f}") for name in ("median", "q25", "q75"))
    return f"{middle} ({low}-{high})" if middle else ""
