import json
import math
import shlex

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from isacbench.bench.run.runner import run, run_suite
from isacbench.bench.store.manifest import command_to_show, read_manifest
from isacbench.errors import InputError
from isacbench.model.cloud import PointCloud
from isacbench.model.scenes.scenario import load_scenario
from isacbench.plugins.scoring import score
from tests.conftest import PLUGINS
from tests.score_tables import METRICS

TIMES = ["time_estimate_s", "time_score_s"]


def test_there_is_one_row_for_every_scenario_snr_trial_and_estimator_with_every_score(records):
    keys = records[["scenario", "snr_db", "trial", "estimator"]]
    assert len(records) == len(keys.drop_duplicates()) == 2 * 3 * 2
    assert set(records["status"]) == {"ok"}
    assert set(records["reason"]) == {""}
    assert set(records["seed"]) == {1}
    # The pinned columns lead in their order.
    assert " ".join(records.columns[:20]) == (
        "suite scenario estimator params snr_db trial seed status reason n_true n_estimated hausdorff_xy_m "
        "hausdorff_xz_m hausdorff_yz_m density velocity_nmse deviation chamfer_m gospa_m time_estimate_s"
    )
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


def test_an_empty_cloud_is_no_detection_scored_by_the_region_and_velocity_bin_of_the_scenario(suite, tiny):
    row = run(suite, estimators=["trouble[kind=empty]"], snr_db=0, trials=1).iloc[0]
    scenario = load_scenario(tiny)
    expected = score(
        scenario.truth,
        PointCloud.empty(),
        region=scenario.region,
        velocity_bin_mps=scenario.system.velocity_bin_mps,
    )
    assert row["status"] == "no_detection"
    assert math.isfinite(row["deviation"])
    assert row["deviation"] == expected["deviation"]


def test_only_an_estimator_that_declares_its_need_sees_the_truth(records):
    assert (records.loc[records["estimator"] == "seer", "deviation"] == 0).all()
    assert (records.loc[records["estimator"] == "blob", "deviation"] > 0).all()


def test_a_failure_is_a_row_with_its_reason_and_spares_the_others(suite):
    records = run(suite, estimators=["trouble", "seer"])
    failed = records[records["estimator"] == "trouble"]
    assert set(failed["status"]) == {"error"}
    assert set(failed["reason"]) == {"ZeroDivisionError: no luck (test_plugins.py, line 68, in estimate)"}
    assert failed["deviation"].isna().all()
    assert (failed["time_estimate_s"] >= 0).all()
    assert set(failed["n_true"]) == {3}
    assert set(records.loc[records["estimator"] == "seer", "status"]) == {"ok"}


def test_an_estimator_that_writes_to_the_observation_fails(suite):
    (reason,) = run(suite, estimators=["trouble[kind=write]"], snr_db=0, trials=1)["reason"]
    assert "read-only" in reason


def test_an_estimator_runs_on_one_thread_and_the_threads_come_back(suite, monkeypatch):
    seen = []

    def spy(*args):
        seen.extend(library["num_threads"] for library in threadpool_info())
        return PointCloud.empty()

    monkeypatch.setattr("isacbench.bench.cells.task.estimate_cloud", spy)
    with threadpool_limits(limits=2):
        # A library that other tests have loaded may have one thread in any case.
        before = {library["filepath"]: library["num_threads"] for library in threadpool_info()}
        run(suite, snr_db=0, trials=1)
        after = {library["filepath"]: library["num_threads"] for library in threadpool_info()}
    assert seen
    assert set(seen) == {1}
    assert 2 in before.values()
    assert {path: after[path] for path in before} == before


def test_an_interrupt_keeps_and_writes_the_rows_so_far_and_reaches_a_caller_of_run(suite, tmp_path):
    out, suite = tmp_path / "run", suite.replace(estimators=["seer", "trouble[kind=interrupt]"])
    results = run_suite(suite, out=out)
    assert results.manifest["interrupted"]
    assert len(results.rows) == 1
    assert json.loads((out / "manifest.json").read_text())["interrupted"] is True
    assert (out / "results.parquet").is_file()
    with pytest.raises(KeyboardInterrupt, match=r"after 1 cells, written to .*run"):
        run(suite, out=out)


def test_an_interrupt_before_the_first_row_still_yields_a_readable_table(suite, records):
    results = run_suite(suite.replace(estimators=["trouble[kind=interrupt]"]))
    assert results.manifest["interrupted"]
    assert results.rows.columns.equals(records.columns)
    assert len(results.rows) == len(results.clouds) == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"estimators": ["blop"]}, "unknown estimator 'blop'"),
        ({"estimators": ["blob", "blob[n=4]"]}, "equal parameters"),
        ({"scenarios": ["streat"]}, "unknown scenario 'streat'"),
        ({"scenarios": ["tiny.toml", "copy.toml"]}, "repeats the name 'tiny'"),
        ({"scenarios": ["bare.toml"]}, "has no scatterers"),
    ],
)
def test_a_mistake_is_found_before_anything_is_made(suite, tiny, tmp_path, monkeypatch, change, message):
    monkeypatch.chdir(tmp_path)
    tiny.with_name("copy.toml").write_text(tiny.read_text())
    tiny.with_name("bare.toml").write_text(tiny.read_text().partition("[[objects]]")[0])
    with pytest.raises(InputError, match=message.replace("[", r"\[")):
        run(suite, out=tmp_path / "run", **change)
    assert not (tmp_path / "run").exists()


def test_commands_name_the_plugin_file_that_they_need(tiny, write_plugin, tmp_path):
    path = write_plugin("my plugin.py", PLUGINS)
    asked = {"scenarios": [tiny], "snr_db": [0, 5], "trials": 1, "out": tmp_path / "run", "plugins": [path]}
    run("quick", estimators=["trouble", "oracle"], **asked)
    manifest = read_manifest(tmp_path / "run")
    command = command_to_show(manifest, "tiny", "trouble", 5.0, 0)
    assert command == shlex.join(
        ["isacbench", "image", "-s", str(tiny), "-e", "trouble", "--snr", "5", "--plugin", str(path)]
    )
    assert "--plugin" not in command_to_show(manifest, "tiny", "oracle", 5.0, 0)
