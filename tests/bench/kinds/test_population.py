import dataclasses

import numpy as np
import pandas as pd
import pytest

from isacbench.bench.kinds import lone_targets
from isacbench.bench.kinds.population import (
    ALL,
    PopulationSuite,
    scene_cells,
    spread_levels,
    summarise_population,
)
from isacbench.bench.run.rescoring import rescore
from isacbench.bench.run.runner import run_suite
from isacbench.bench.statistics import mean_band, median_interval
from isacbench.model.scenes.scenario import load_scenario


def entry(summary, estimator="a", family=ALL, frame=ALL, phases=ALL, snr_db=None):
    """Row of a summary."""
    is_snr = summary["snr_db"].isna() if snr_db is None else summary["snr_db"] == snr_db
    values = {"estimator": estimator, "family": family, "frame": frame, "phases": phases}
    chosen = summary[is_snr & np.all([summary[name] == value for name, value in values.items()], axis=0)]
    assert len(chosen) == 1
    return chosen.iloc[0]


def test_means_and_medians_are_over_scenes_and_not_over_cells(population_rows):
    errors = np.arange(1.0, 9.0) ** 2
    rows = population_rows(families=["town"], a=errors, oracle=2.0)
    # Further cells of a single scene must not give that scene more weight.
    more = rows[rows["scenario"] == "town[seed=7]"].assign(snr_db=30.0)
    found = entry(summarise_population(pd.concat([rows, more], ignore_index=True)))
    assert found["n_scenes"] == 8
    assert found["n_cells"] == 18
    assert (found["gospa_m_mean"], found["gospa_m_band"]) == pytest.approx(mean_band(errors))
    median = [found[f"ratio_{name}"] for name in ("median", "low", "high")]
    assert median == pytest.approx(median_interval(errors / 2))
    quartiles = [found["ratio_q25"], found["ratio_q75"]]
    assert quartiles == pytest.approx(np.quantile(errors / 2, [0.25, 0.75]).tolist())
    assert found["time_estimate_s_median"] == 0.1


def test_every_level_has_its_own_scenes(population_rows):
    rows = population_rows(families=["town", "crowd"], a=np.arange(8.0), oracle=1.0)
    rows.loc[rows["family"] == "crowd", "gospa_m"] += 100
    rows.loc[rows["snr_db"] == 10, "gospa_m"] += 1000
    summary = summarise_population(rows)
    assert entry(summary, family="town", snr_db=0.0)["gospa_m_mean"] == 3.5
    assert entry(summary, family="crowd", snr_db=10.0)["gospa_m_mean"] == 1103.5
    assert entry(summary, family="crowd")["gospa_m_mean"] == 603.5
    assert entry(summary)["gospa_m_mean"] == 553.5
    paper = entry(summary, family="town", frame="paper", phases="carrier", snr_db=0.0)
    assert (paper["n_scenes"], paper["gospa_m_mean"]) == (2, 5.0)  # the scenes 3 and 7
    levels = summary.groupby("estimator").size()
    assert (levels == 3 * 5 * 3).all()  # families, frames with phases, SNRs, each with all of them


def test_rows_repeat_for_each_of_eight_levels(population_rows):
    cells = scene_cells(population_rows(a=1.0))
    assert len(spread_levels(cells)) == 8 * len(cells)


def test_lone_scatterers_have_targets_and_no_ratio_and_others_have_ratios_and_no_targets(population_rows):
    rows = population_rows(a=3.0, oracle=0.0)
    lone = rows["family"] == "sparse"
    rows.loc[lone & (rows["snr_db"] == 10), ["n_resolved", "n_false"]] = [5, 0]
    rows.loc[lone & (rows["snr_db"] == 0), ["n_resolved", "n_false"]] = [3, 2]
    summary = summarise_population(rows)
    sparse, town, both = entry(summary, family="sparse"), entry(summary, family="town"), entry(summary)
    assert np.isnan(sparse["ratio_median"])
    assert town["ratio_median"] == pytest.approx(10.0)  # 3 m over the least denominator, 0.3 m
    assert both["ratio_median"] == pytest.approx(10.0)
    targets = ["n_false_mean", "share_clean_mean", "share_resolved_mean", "share_met_mean"]
    assert sparse[targets].tolist() == pytest.approx([1, 0.5, 0.8, 0.5])
    assert town[targets].isna().all()
    assert both[targets].isna().all()


def test_a_failed_cell_of_lone_scatterers_meets_no_target(population_rows):
    rows = population_rows(families=["sparse"], a=1.0, b=1.0)
    rows["n_resolved"] = 5
    broken = (rows["estimator"] == "a") & (rows["scenario"] == "sparse[seed=0]")
    rows.loc[broken, ["status", "n_resolvable", "n_resolved", "gospa_m"]] = ["error", 0, 0, np.nan]
    found = entry(summarise_population(rows), family="sparse")
    assert found["n_failed"] == 2
    assert found["n_false_mean"] == 0  # what failed has no points, and is not counted
    assert found[["share_clean_mean", "share_resolved_mean", "share_met_mean"]].tolist() == [7 / 8] * 3


def test_hand_made_scenes_have_a_family_of_their_own_name(population_rows):
    summary = summarise_population(population_rows(families=["", "town"], a=1.0))
    assert summary["family"].unique().tolist() == ["all", "hand-made", "town"]


def test_targets_of_lone_scatterers_are_rescored_from_clouds(plugins, tiny, tmp_path, monkeypatch):
    def load(name):
        return dataclasses.replace(load_scenario(tiny), name=name, family="sparse", family_version=1)

    monkeypatch.setattr("isacbench.bench.plan.job.load_scenario", load)
    suite = PopulationSuite(
        name="p",
        version=1,
        scenarios=["sparse[seed=1]"],
        estimators=["seer", "trouble"],
        snr_db=[20.0],
        trials=1,
    )
    seen, broken = run_suite(suite, tmp_path / "run").rows.to_dict("records")
    assert [seen[name] for name in ("n_resolvable", "n_resolved", "n_false")] == [3, 3, 0]
    assert [broken[name] for name in ("family", "frame", "coherent_phase")] == ["sparse", "panel", True]
    assert rescore(tmp_path / "run").changes == []
    monkeypatch.setattr(lone_targets, "RESOLVABLE_CELLS", 0.0)
    changes = rescore(tmp_path / "run").changes
    assert {change.column: change.n_rows for change in changes} == {"n_resolvable": 1, "n_resolved": 1}
