import json
import math

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from isacbench.bench.cells.cell import estimate_cloud, run_cell
from isacbench.bench.cells.record import Cell
from isacbench.bench.run.runner import run, run_suite
from isacbench.errors import InputError
from isacbench.metrics.score import METRICS, score
from isacbench.model.cloud import PointCloud
from isacbench.model.echo import observe_echo
from isacbench.model.scenes.scenario import load_scenario

PINNED = [
    "suite",
    "scenario",
    "estimator",
    "params",
    "snr_db",
    "trial",
    "seed",
    "status",
    "reason",
    "n_true",
    "n_estimated",
    "hausdorff_xy_m",
    "hausdorff_xz_m",
    "hausdorff_yz_m",
    "density",
    "velocity_nmse",
    "deviation",
    "chamfer_m",
    "gospa_m",
    "time_estimate_s",
]
TIMES = ["time_estimate_s", "time_score_s"]


def test_there_is_one_row_for_every_scenario_snr_trial_and_estimator_with_every_score(records):
    keys = records[["scenario", "snr_db", "trial", "estimator"]]
    assert len(records) == len(keys.drop_duplicates()) == 2 * 3 * 2
    assert set(records["status"]) == {"ok"}
    assert set(records["reason"]) == {""}
    assert set(records["seed"]) == {1}
    # The pinned columns lead in their order.
    assert records.columns.tolist()[: len(PINNED)] == PINNED
    assert set(METRICS["paper"]) <= set(records.columns)


def test_the_same_seed_gives_the_same_rows_and_another_seed_others(suite, records):
    first, again, other = records, run(suite), run(suite, seed=2)
    assert first.drop(columns=TIMES).equals(again.drop(columns=TIMES))
    blob = first["estimator"] == "blob"
    assert (first.loc[blob, "deviation"] != other.loc[blob, "deviation"]).all()


def test_rows_do_not_depend_on_which_estimators_and_snrs_run_beside(suite, records):
    alone = run(suite, estimators=["blob"], snr_db=0)
    beside = records.query("estimator == 'blob' and snr_db == 0").reset_index(drop=True)
    assert alone.drop(columns=TIMES).equals(beside.drop(columns=TIMES))


def test_scores_use_the_region_and_the_velocity_bin_of_the_scenario(suite, tiny):
    row = run(suite, estimators=["trouble[kind=empty]"], snr_db=0, trials=1).iloc[0]
    scenario = load_scenario(tiny)
    expected = score(
        scenario.truth,
        PointCloud.empty(),
        region=scenario.region,
        velocity_bin_mps=scenario.system.velocity_bin_mps,
    )
    assert row["deviation"] == expected["deviation"]


def test_only_an_estimator_that_declares_its_need_sees_the_truth(records):
    assert (records.loc[records["estimator"] == "seer", "deviation"] == 0).all()
    assert (records.loc[records["estimator"] == "blob", "deviation"] > 0).all()


def test_a_declaration_of_no_need_hides_the_truth(tiny):
    class Modest:
        name = "modest"
        needs_truth = False

        def estimate(self, observation):
            return PointCloud.empty()

    scenario = load_scenario(tiny)
    assert len(estimate_cloud(Modest(), observe_echo(scenario, 0), scenario.truth)) == 0


def test_a_failure_is_a_row_with_its_reason_and_spares_the_others(suite):
    records = run(suite, estimators=["trouble", "seer"])
    failed = records[records["estimator"] == "trouble"]
    assert set(failed["status"]) == {"error"}
    assert set(failed["reason"]) == {"ZeroDivisionError: no luck"}
    assert failed["deviation"].isna().all()
    assert (failed["time_estimate_s"] >= 0).all()
    assert set(failed["n_true"]) == {3}
    assert set(records.loc[records["estimator"] == "seer", "status"]) == {"ok"}


def test_an_empty_cloud_is_no_detection_with_finite_scores(suite):
    records = run(suite, estimators=["trouble[kind=empty]"])
    assert set(records["status"]) == {"no_detection"}
    assert np.isfinite(records["deviation"]).all()


def test_an_estimator_that_writes_to_the_observation_or_returns_no_cloud_fails(suite):
    records = run(suite, estimators=["trouble[kind=[write,list]]"], trials=1)
    reasons = records.groupby("params")["reason"].unique()
    assert "read-only" in reasons['{"kind":"write"}'].item()
    told = "TypeError: estimate() must return a PointCloud, not list"
    assert reasons['{"kind":"list"}'].item() == told


def test_an_estimator_runs_on_one_thread_and_the_threads_come_back(suite, monkeypatch):
    seen = []

    def spy(*args):
        seen.extend(library["num_threads"] for library in threadpool_info())
        return PointCloud.empty()

    monkeypatch.setattr("isacbench.bench.cells.cell.estimate_cloud", spy)
    with threadpool_limits(limits=2):
        # A library that other tests have loaded may have one thread in any case.
        before = {library["filepath"]: library["num_threads"] for library in threadpool_info()}
        run(suite, snr_db=0, trials=1)
        after = {library["filepath"]: library["num_threads"] for library in threadpool_info()}
    assert seen
    assert set(seen) == {1}
    assert 2 in before.values()
    assert {path: after[path] for path in before} == before


def test_progress_counts_every_cell_up_to_all(suite):
    calls = []
    run_suite(suite, progress=lambda done, total: calls.append((done, total)))
    assert calls == [(done, 12) for done in range(1, 13)]


def test_params_tell_variants_of_one_estimator_apart(suite):
    records = run(suite, estimators=["blob", "blob[n=5]"], trials=1)
    assert set(records["estimator"]) == {"blob"}
    assert {json.loads(params)["n"] for params in records["params"]} == {4, 5}


def test_an_interrupt_keeps_and_writes_the_rows_so_far(suite, tmp_path):
    out = tmp_path / "run"
    results = run_suite(suite.replace(estimators=["seer", "trouble[kind=interrupt]"]), out=out)
    assert results.interrupted
    assert len(results.records) == 1
    assert json.loads((out / "manifest.json").read_text())["interrupted"] is True
    assert (out / "results.parquet").is_file()


def test_an_interrupt_before_the_first_row_still_yields_a_readable_table(suite):
    results = run_suite(suite.replace(estimators=["trouble[kind=interrupt]"]))
    assert results.interrupted
    assert results.records.columns.tolist()[: len(PINNED)] == PINNED
    assert len(results.records) == len(results.clouds) == 0


def test_an_interrupt_reaches_a_caller_of_run_and_says_where_the_rows_are(suite, tmp_path):
    with pytest.raises(KeyboardInterrupt, match=r"after 1 cells, written to .*run"):
        run(suite, estimators=["seer", "trouble[kind=interrupt]"], out=tmp_path / "run")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"estimators": ["blop"]}, "unknown estimator 'blop'"),
        ({"estimators": ["blob", "blob[n=4]"]}, "equal parameters"),
        ({"scenarios": ["streat"]}, "unknown scenario 'streat'"),
        ({"trials": 0}, "trials = 0"),
        ({"snr_db": [math.nan]}, "snr_db"),
    ],
)
def test_a_mistake_is_found_before_anything_is_made(suite, tmp_path, change, message):
    with pytest.raises(InputError, match=message.replace("[", r"\[")):
        run(suite, out=tmp_path / "run", **change)
    assert not (tmp_path / "run").exists()


def test_two_scenarios_of_one_name_are_refused(suite, tiny):
    copy = tiny.with_name("copy.toml")
    copy.write_text(tiny.read_text())
    with pytest.raises(InputError, match="repeats the name 'tiny'"):
        run(suite, scenarios=[tiny, copy])


def test_a_scenario_without_scatterers_is_refused(suite, tiny):
    tiny.write_text(tiny.read_text().partition("[[objects]]")[0])
    with pytest.raises(InputError, match="has no scatterers"):
        run(suite)


def test_a_cell_is_a_function_of_its_arguments(tiny):
    class Echoing:
        name = "echoing"

        def estimate(self, observation):
            return PointCloud([[1, 2, 3]], [0], [1])

    scenario = load_scenario(tiny)
    cell = Cell("suite", "tiny", "echoing", "{}", 0.0, 0, 0, "content")
    outcome = run_cell(cell, scenario, observe_echo(scenario, 0), Echoing())
    assert (outcome.record.n_true, outcome.record.n_estimated, len(outcome.cloud)) == (3, 1, 1)
    assert outcome.record.status == "ok"
