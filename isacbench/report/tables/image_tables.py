"""Tables of images: scores over SNR, an estimator a group of columns, and the objects that were detected."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import pandas as pd

from isacbench.bench.plan.labels import estimator_labels, variants_in
from isacbench.bench.studies.imaging_study import MANY_SCENARIOS, average_scenarios, summarise_scores
from isacbench.bench.studies.medians import TIME, median_times, time_words
from isacbench.metrics.realisations import SPREAD_COLUMNS
from isacbench.report.tables.detected_objects import object_grids
from isacbench.report.tables.run_tables import (
    Grid,
    batched,
    mean_of_scenarios,
    mean_of_trials,
    milliseconds,
    with_failures,
    written,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from isacbench.bench.plan.labels import Variant

SHOWN = {
    "hausdorff_sum_m": "Hausdorff [m]",
    "f_score": "F-score",
    "objects_f_score": "objects",
    "gospa_skill": "GOSPA skill",
    "precision": "precision",
    "recall": "recall",
    "spatial": "spatial",
    "velocity_nmse": "kinematic",
}
"""Scores that a table shows after the deviation, with their headings; the last two are its parts."""

SPARE = ("objects_f_score",), ("gospa_skill",), ("precision", "recall"), ("spatial", "velocity_nmse")
"""Scores that a terminal shows where there is room; the last ones are left out first."""

DEVIATION_SPREAD = SPREAD_COLUMNS["deviation"]
VARIANT = ["estimator", "params"]
ESTIMATORS_A_TABLE = 4


def score_grids(records: pd.DataFrame) -> list[Grid]:
    """Lay out scores and times of a run, estimators over SNR.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.

    Returns
    -------
    list of Grid
        One a scenario, or more where the estimators are too many for the
        width of a terminal. Of more than 12 scenarios first their mean; the others are details.
    """
    labels = estimator_labels(variants_in(records))
    n_scenarios, found = records["scenario"].nunique(), []
    is_detail = n_scenarios > MANY_SCENARIOS
    if is_detail:
        title = f"{mean_of_scenarios(n_scenarios)}; {time_words(records)} of an image"
        of_all_s = median_times(records, VARIANT)[f"{TIME}_median"]
        all_s = {variant: of_all_s.get(variant, math.nan) for variant in labels}
        found += _estimators_over_snr(average_scenarios(records), title, labels, all_s)
    times_s, words = median_times(records, ["scenario", *VARIANT])[f"{TIME}_median"], time_words(records)
    for scenario, part in summarise_scores(records).groupby("scenario", sort=False):
        title = f"{scenario}: {mean_of_trials(int(part['n_cells'].max()))}; {words} of an image"
        if DEVIATION_SPREAD in records and records[DEVIATION_SPREAD].notna().any():
            title += "; ± of references: spread over realisations"
        own_s = {variant: times_s.get((scenario, *variant), math.nan) for variant in labels}
        grids = _estimators_over_snr(part, title, labels, own_s)
        found += [grid._replace(is_detail=is_detail) for grid in grids]
    return [*found, *object_grids(records, labels)]


def _estimators_over_snr(
    summary: pd.DataFrame, title: str, labels: Mapping[Variant, str], times_s: Mapping[Variant, float]
) -> list[Grid]:
    """Tables of one scenario, or of a mean over scenarios, a few estimators in each."""
    summary = summary.assign(spatial_mean=summary["hausdorff_sum_m_mean"] + summary["density_mean"])
    shown = {score: name for score, name in SHOWN.items() if f"{score}_mean" in summary}
    forms = {score: "{:.1e}" if score == "velocity_nmse" else "{:.2f}" for score in shown}
    scores = pd.DataFrame(
        {score: [written(mean, form) for mean in summary[f"{score}_mean"]] for score, form in forms.items()},
        index=summary.index,
    )
    scores.insert(0, "deviation", [deviation_text(entry) for _, entry in summary.iterrows()])
    names = list(scores)
    texts = pd.concat([summary[["snr_db", *VARIANT]], scores], axis=1)
    table = texts.pivot(index="snr_db", columns=VARIANT, values=names).fillna("")
    found = []
    for batch in batched(variants_in(summary), ESTIMATORS_A_TABLE):
        header, last = ["SNR [dB]"], ["time [ms]"]
        for variant in batch:
            header += [f"{labels[variant]}: deviation", *shown.values()]
            last += [milliseconds(times_s[variant]), *[""] * len(shown)]
        cells = table[[(score, *variant) for variant in batch for score in names]]
        rows = [[f"{snr_db:g}", *texts] for snr_db, *texts in cells.itertuples()]
        spare = [
            [place for place, name in enumerate(header) if name in [SHOWN[score] for score in group]]
            for group in SPARE
        ]
        found.append(Grid(title, header, [*rows, last], spare))
    return found


def deviation_text(entry: pd.Series[Any]) -> str:
    """Write the mean deviation of some trials with its band, and the number of trials that failed.

    Parameters
    ----------
    entry : Series
        With ``deviation_mean``, ``deviation_band`` and ``n_failed``.

    Returns
    -------
    str
    """
    mean = written(entry["deviation_mean"], "{:.2f}")
    return with_failures(mean + written(entry["deviation_band"], " ±{:.2f}"), entry["n_failed"])
