"""References in runs: rows of means, made once for a scenario, stored, merged, resumed, scored again."""

import numpy as np
import pandas as pd
import pytest

import isacbench
from isacbench.bench.cells import images
from isacbench.bench.cells.images import image_reference
from isacbench.bench.cells.rows import REFERENCE_COLUMNS, TIMES
from isacbench.bench.compare.comparison import direction
from isacbench.bench.kinds.scores import summarise_scores
from isacbench.bench.run.merging import merge
from isacbench.bench.run.rescoring import rescore
from isacbench.bench.run.runner import run, run_suite
from isacbench.bench.store.run import Run, load_run
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputError
from isacbench.metrics.realisations import SPREAD_COLUMNS
from isacbench.model.scenes.scenario import load_scenario
from isacbench.plugins.registry import canonical_params
from isacbench.plugins.scoring import Metrics, score
from tests.conftest import hide_estimators
from tests.score_tables import METRICS

REFERENCES = ["oracle", "oracle[cell=0.5]", "chance"]

CLOSE = """\
x,y,z,v
1,1,1,2
1.5,1.4,1,2
2,3.9,1.2,2.5
6,4,3,-4
6.5,4.2,3,-4
9,6,1,0
9,7,2.5,0
9,8.8,4.5,0.3
"""

DESCRIBED = Metrics().columns(())


@pytest.fixture
def close(tiny):
    """Path of a scenario with scatterers that share cells, or not, as the borders lie."""
    (tiny.parent / "tiny.csv").write_text(CLOSE)
    scenario = load_scenario(tiny)
    sizes = {len(cloud) for cloud in isacbench.get_estimator("oracle").realisations(scenario, scenario.truth)}
    assert len(sizes) > 1
    return tiny


@pytest.fixture
def suite(plugins, close):
    return Suite(
        name="test",
        scenarios=[str(close)],
        estimators=["blob", *REFERENCES, "trouble"],
        snr_db=[-10, 0],
        trials=2,
    )


@pytest.fixture
def folder(suite, run_once):
    """Return a folder that holds a run of the suite."""
    return run_once("first", suite)


@pytest.fixture
def first(folder):
    """Rows of this run."""
    return Run.open(folder).rows


def is_of_reference(records):
    return records["estimator"].isin(["oracle", "chance"])


def test_rows_are_means_over_the_realisations_with_their_spreads(first, close):
    scenario = load_scenario(close)
    given = {"region": scenario.region, "velocity_bin_mps": scenario.system.velocity_bin_mps}
    for name, params in (("oracle", {}), ("oracle", {"cell": 0.5}), ("chance", {})):
        reference = isacbench.get_estimator(name, **params)
        clouds = reference.realisations(scenario, scenario.truth)
        expected = pd.DataFrame([score(scenario.truth, cloud, **given) for cloud in clouds])
        rows = first[(first["estimator"] == name) & (first["params"] == canonical_params(reference))]
        # Every SNR and trial has the same scores.
        assert len(rows) == 4
        scores = ["n_stored", *METRICS["paper"], *SPREAD_COLUMNS.values()]
        assert (rows[scores].nunique() == 1).all()
        row = rows.iloc[0]
        for score_name in METRICS["paper"]:
            mean = expected[score_name].mean()
            wanted = round(mean) if score_name == "n_estimated" else pytest.approx(mean, rel=1e-12)
            assert row[score_name] == wanted
        for score_name, column in SPREAD_COLUMNS.items():
            assert row[column] == pytest.approx(expected[score_name].std(ddof=0), rel=1e-9, abs=1e-12)
        nearest = (expected["deviation"] - expected["deviation"].mean()).abs().argmin()
        assert row["n_stored"] == len(clouds[nearest])


def test_only_a_run_with_references_has_columns_of_spreads_and_only_their_rows_have_values(suite, first):
    records = first
    assert records.columns.tolist()[-len(REFERENCE_COLUMNS) :] == list(REFERENCE_COLUMNS)
    spreads = records[list(REFERENCE_COLUMNS)].notna()
    assert spreads[is_of_reference(records)].all(axis=None)
    assert not spreads[~is_of_reference(records)].any(axis=None)
    assert not set(REFERENCE_COLUMNS) & set(run(suite, estimators=["blob", "seer"], trials=1))


def test_a_reference_is_scored_once_for_all_snrs_and_trials_of_a_scenario(suite, monkeypatch):
    calls = []
    score_all = images.score_realisations

    def counted(*arguments, **given):
        calls.append(arguments)
        return score_all(*arguments, **given)

    monkeypatch.setattr(images, "score_realisations", counted)
    images._imaged.cache_clear()
    records = run_suite(suite).rows
    assert is_of_reference(records).sum() == 12
    assert len(calls) == len(REFERENCES)


def test_what_is_remembered_is_that_of_equal_content_only(close):
    from dataclasses import replace

    oracle, scenario = isacbench.get_estimator("oracle"), load_scenario(close)
    first = image_reference(oracle, scenario)
    assert image_reference(oracle, load_scenario(close)) is first
    assert image_reference(isacbench.get_estimator("oracle", cell=1.0), scenario) is first
    moved = replace(scenario.scatterers, velocity=scenario.scatterers.velocity * 0.5)
    for other in (
        replace(scenario, radius_m=0.5),
        replace(scenario, scatterers=moved),
        replace(scenario, base_station_m=scenario.base_station_m + 0.01),
        replace(scenario, system=replace(scenario.system, carrier_hz=60e9)),
    ):
        assert image_reference(oracle, other) is not first
    assert image_reference(isacbench.get_estimator("oracle", cell=2.0), scenario) is not first


def test_the_stored_cloud_is_that_of_the_estimate_and_processes_give_the_same_rows(
    suite, first, close, tmp_path
):
    guarded = run(suite, jobs=1, out=tmp_path / "run")
    pd.testing.assert_frame_equal(guarded.drop(columns=TIMES), first.drop(columns=TIMES))
    scenario, stored = load_scenario(close), load_run(tmp_path / "run")
    observation = isacbench.observe(scenario, 0.0)
    oracle, chance = isacbench.get_estimator("oracle"), isacbench.get_estimator("chance")
    for reference in (oracle, chance):
        params = canonical_params(reference)
        cloud = stored.cloud(estimator=reference.name, params=params, snr_db=0.0, trial=1)
        expected = reference.estimate(observation, scenario.truth)
        np.testing.assert_array_equal(cloud.to_array(), expected.to_array())
    from_csv = pd.read_csv(tmp_path / "run" / "results.csv")
    np.testing.assert_allclose(from_csv["deviation_spread"], first["deviation_spread"], rtol=1e-12)


def test_a_stored_cloud_that_lost_points_is_noticed_and_made_again(suite, first, folder):
    clouds = pd.read_parquet(folder / "clouds.parquet")
    clouds.attrs = {}
    lost = clouds.index[clouds["estimator"] == "oracle"][0]
    clouds.drop(index=lost).to_parquet(folder / "clouds.parquet", index=False)
    with pytest.raises(InputError, match=r"1 of \d+ clouds are missing or damaged"):
        rescore(folder)
    again = run(suite, out=folder)
    pd.testing.assert_frame_equal(again.drop(columns=TIMES), first.drop(columns=TIMES))
    assert rescore(folder).n_changed == 0


def test_runs_with_and_without_references_are_merged(suite, folder, tmp_path):
    run(suite, estimators=["seer"], out=tmp_path / "without")
    records = merge([tmp_path / "without", folder], tmp_path / "both").run.rows
    assert set(records["estimator"]) == {"seer", "blob", "oracle", "chance", "trouble"}
    assert records["deviation_spread"].notna().tolist() == is_of_reference(records).tolist()


def test_rows_of_references_are_scored_again_from_their_realisations(first, folder):
    records = first.copy()
    for name in ("deviation", "recall", "deviation_spread", "hausdorff_sum_m_spread"):
        records[name] += 1
    records.to_parquet(folder / "results.parquet", index=False)
    images._imaged.cache_clear()
    rescored = rescore(folder)
    assert rescored.n_changed == (first["status"] == "ok").sum()
    pd.testing.assert_frame_equal(rescored.run.rows, first)


@pytest.mark.parametrize("gone", ["all", "chance"])
def test_a_reference_that_is_not_installed_cannot_be_scored_again_and_the_run_stays(
    folder, monkeypatch, gone
):
    before = (folder / "results.parquet").read_bytes()
    if gone == "all":
        hide_estimators(monkeypatch)
    else:
        monkeypatch.setattr(
            "isacbench.bench.run.rescoring.get_estimator",
            lambda name, **_: isacbench.get_estimator("oracle" if name == "oracle" else "music2d"),
        )
    what = "'oracle'.*unknown estimator" if gone == "all" else "'chance'.*has no realisations"
    with pytest.raises(InputError, match=f"the scores of {what}"):
        rescore(folder)
    assert (folder / "results.parquet").read_bytes() == before


def test_the_band_of_a_reference_is_its_spread_whatever_the_number_of_trials(suite):
    all_trials = run(suite, estimators=["blob", "oracle"], snr_db=[0.0], trials=6)
    for trials in (1, 6):
        records = all_trials[all_trials["trial"] < trials]
        summary = summarise_scores(records)
        oracle, blob = (summary[summary["estimator"] == name] for name in ("oracle", "blob"))
        for name in ("deviation", "hausdorff_sum_m", "gospa_m", "n_estimated"):
            spread = records.loc[records["estimator"] == "oracle", SPREAD_COLUMNS[name]].iloc[0]
            assert oracle[f"{name}_band"].to_numpy() == pytest.approx(spread)
        assert blob["deviation_band"].isna().all() == (trials < 5)


def test_spreads_have_no_better_direction():
    with pytest.raises(InputError, match="deviation_spread has no better direction"):
        direction("deviation_spread", DESCRIBED, ["deviation", "deviation_spread"])


def test_an_estimator_that_only_claims_realisations_gets_no_truth(suite):
    from dataclasses import dataclass
    from typing import ClassVar

    @dataclass(frozen=True)
    class Sly:
        name: ClassVar[str] = "sly"
        needs_truth: ClassVar[bool] = False

        def estimate(self, observation, truth=None):
            assert truth is None
            return isacbench.PointCloud.empty()

        def realisations(self, radio, truth):
            raise AssertionError("it sees the truth")

    records = run(suite, estimators=[Sly()], snr_db=[0.0], trials=1)
    assert records["status"].tolist() == ["no_detection"]
