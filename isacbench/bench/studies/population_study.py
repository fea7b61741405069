"""The study ``population``: many scenes as they are, tabulated by family; the scene is the unit."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from isacbench.bench.cells.statuses import failed
from isacbench.bench.store.score_columns import metrics_of
from isacbench.bench.studies.imaging_study import averaged_columns
from isacbench.bench.studies.intervals import median_interval, student_band
from isacbench.bench.studies.lone_targets import measure_lone_scatterers
from isacbench.bench.studies.medians import median_times
from isacbench.bench.studies.ratios import POINT_FAMILIES, hausdorff_ratios
from isacbench.bench.studies.study import (
    ImagedScene,
    build_estimators,
    element_snrs_db,
    require_scatterers,
)
from isacbench.model.frame import PaperFrame
from isacbench.model.radio_coordinates import gain_db

if TYPE_CHECKING:
    from collections.abc import Mapping

    from isacbench.bench.suites.population_kind import PopulationSuite
    from isacbench.model.scene import Scenario

ALL = "all"
"""Value of `family`, `frame` and `phases` in a row over all of them."""

HAND_MADE = "hand-made"
"""Value of `family` of scenes that no family made."""

PHASES = {False: "in phase", True: "carrier"}
"""Value of `phases` by the column ``coherent_phase``."""

PART = ["family", "frame", "phases", "snr_db"]
"""Columns that say of which scenes and SNRs a row of the summary is."""

VARIANT = ["estimator", "params"]

MEDIANS = ["ratio", "velocity_nmse"]
"""Numbers of a scene whose distribution has a long tail."""

TARGETS = ["n_false", "share_clean", "share_resolved", "share_met"]
"""Numbers of a scene of lone scatterers."""


def population_scenes(suite: PopulationSuite, scenarios: Mapping[str, Scenario]) -> list[ImagedScene]:
    """Plan one scene a scenario: the scenario as it is, labelled with family, frame and phases.

    Parameters
    ----------
    suite : PopulationSuite
    scenarios : mapping of str to Scenario
        By name.

    Returns
    -------
    list of ImagedScene

    Raises
    ------
    InputError
        If a scenario has no scatterers.
    """
    entries, metrics = build_estimators(suite), metrics_of(suite)
    require_scatterers(scenarios)
    return [
        ImagedScene(
            suite,
            scenario,
            entries,
            element_snrs_db(suite, gain_db(scenario)),
            measure=measure_lone_scatterers if scenario.family in POINT_FAMILIES else None,
            metrics=metrics,
            labels={
                "family": scenario.family,
                "frame": "paper" if isinstance(scenario.frame, PaperFrame) else "panel",
                "coherent_phase": scenario.system.coherent_phase,
            },
        )
        for scenario in scenarios.values()
    ]


def summarise_population(records: pd.DataFrame) -> pd.DataFrame:
    """Summarise scenes by family, frame, phases and SNR, and over all of each.

    Scores are averaged within a scene first; failed cells have none. Medians, means and intervals
    are over scenes.

    Parameters
    ----------
    records : DataFrame
        Rows of a run of the kind ``population``.

    Returns
    -------
    DataFrame
        One row for each ``family``, ``frame``, ``phases`` (``"in phase"`` or ``"carrier"``),
        ``snr_db`` and estimator with its parameters. ``"all"``, and an SNR of NaN, stand for a
        row over all; hand-made scenes have the family ``"hand-made"``. Columns: the counts
        ``n_scenes``, ``n_cells``, ``n_no_detection`` and ``n_failed``; of the ratio to the oracle
        (none for families of lone scatterers) and of ``velocity_nmse`` ``..._median`` with its
        95 % interval ``..._low``, ``..._high``, and the quartiles ``..._q25`` and ``..._q75``; of
        other scores ``..._mean`` and ``..._band``, half its 95 % interval (Student's t), from five
        scenes on; of families of lone scatterers likewise ``n_false``, false points an image,
        ``share_clean``, images without any, ``share_resolved``, resolvable scatterers that were
        resolved, and ``share_met``, images with both targets met; ``time_estimate_s_median``.
    """
    cells = spread_levels(scene_cells(records))
    by = [*PART, *VARIANT]
    means = [name for name in averaged_columns(records) if name not in MEDIANS]
    scenes = _scenes(cells, by, [*MEDIANS, *means, *TARGETS])
    groups = scenes.groupby(by, sort=False, dropna=False)
    counts = ["n_cells", "n_no_detection", "n_failed"]
    found = pd.concat([groups.size().rename("n_scenes"), groups[counts].sum()], axis=1)
    columns: dict[str, Any] = {}
    for name in MEDIANS:
        for share in (25, 75):
            columns[f"{name}_q{share}"] = groups[name].quantile(share / 100)
        limits = [median_interval(values.dropna().to_numpy(dtype=np.float64)) for _, values in groups[name]]
        for what, values in zip(("median", "low", "high"), zip(*limits, strict=True), strict=True):
            columns[f"{name}_{what}"] = pd.Series(values, index=found.index)
    for name in [*means, *TARGETS]:
        columns[f"{name}_mean"] = groups[name].mean()
        columns[f"{name}_band"] = student_band(groups[name].std(), groups[name].count())
    found = found.join(pd.DataFrame(columns))
    times = cells.assign(snr_db=cells["snr_db"].fillna(np.inf)).pipe(median_times, by).reset_index()
    times["snr_db"] = times["snr_db"].replace(np.inf, np.nan)
    return found.reset_index().merge(times, how="left", on=by)


def scene_cells(records: pd.DataFrame) -> pd.DataFrame:
    """Add to each row what only a population has: its ratio, and the targets of lone scatterers.

    Parameters
    ----------
    records : DataFrame
        Rows of a run of the kind ``population``.

    Returns
    -------
    DataFrame
        With the further columns ``phases``, ``ratio``, and the targets that
        `summarise_population` names, NaN for other families.
    """
    broken, is_lone = failed(records), records["family"].isin(POINT_FAMILIES)
    cell = ["scenario", "snr_db", "trial"]
    # Failed cells do not know it.
    n_resolvable = records.groupby(cell)["n_resolvable"].transform("max")
    is_clean, is_whole = (
        ~broken & (records["n_false"] == 0),
        ~broken & (records["n_resolved"] == n_resolvable),
    )
    targets = pd.DataFrame(
        {
            "n_false": records["n_false"].where(~broken),
            "share_clean": is_clean,
            "share_resolved": (records["n_resolved"] / n_resolvable).where(n_resolvable > 0),
            "share_met": is_clean & is_whole,
        },
        dtype=np.float64,
    )
    return records.assign(
        family=records["family"].replace("", HAND_MADE),
        phases=records["coherent_phase"].map(PHASES),
        n_estimated=records["n_estimated"].where(~broken),
        ratio=hausdorff_ratios(records, records.loc[is_lone, "scenario"].unique()),
        n_no_detection=records["status"] == "no_detection",
        n_failed=broken,
        **targets.where(is_lone),
    )


def spread_levels(cells: pd.DataFrame) -> pd.DataFrame:
    """Repeat rows for every level of the summary that they belong to.

    Parameters
    ----------
    cells : DataFrame
        As `scene_cells` returns it.

    Returns
    -------
    DataFrame
        Each row eight times: with its own family or ``"all"``, its own frame and phases or
        ``"all"``, its own SNR or NaN. Rows over all families have no targets of lone scatterers.
    """
    together = cells.assign(family=ALL, **dict.fromkeys(TARGETS, np.nan))
    levels = pd.concat([together, cells], ignore_index=True)
    levels = pd.concat([levels.assign(frame=ALL, phases=ALL), levels], ignore_index=True)
    return pd.concat([levels.assign(snr_db=np.nan), levels], ignore_index=True)


def _scenes(cells: pd.DataFrame, by: list[str], scores: list[str]) -> pd.DataFrame:
    """Average the cells of every scene in each group."""
    groups = cells.groupby([*by, "scenario"], sort=False, dropna=False)
    columns: dict[str, Any] = {
        "n_cells": groups.size(),
        "n_no_detection": groups["n_no_detection"].sum(),
        "n_failed": groups["n_failed"].sum(),
    }
    return pd.DataFrame(columns).join(groups[scores].mean()).reset_index()
