import shutil

import numpy as np
import pandas as pd
import pytest

from isacbench.bench.cells.rows import TIMES
from isacbench.bench.kinds.detection import DetectionSuite
from isacbench.bench.run.rescoring import Change, rescore
from isacbench.bench.run.runner import run
from isacbench.bench.store.manifest import read_manifest
from isacbench.bench.store.run import Run
from isacbench.bench.store.run_folder import open_folder
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputError
from isacbench.metrics.paper import Paper
from isacbench.plugins.discovery import entries
from tests.conftest import hide_estimators
from tests.score_tables import METRICS

SCORES = [name for name in METRICS["paper"] if name not in ("n_true", "n_estimated")]
MEASURED = ["hit", "n_false", "error_u", "bound_range_m"]


@pytest.fixture(params=["imaging", "efficiency", "detection"])
def suite(request, plugins, tiny, room_file):
    """Suite of each kind, with a failing estimator and one that detects nothing."""
    common = {"name": "test", "trials": 1, "estimators": ["seer", "blob", "trouble", "trouble[kind=empty]"]}
    rooms = {**common, "scenarios": [str(room_file)], "snr_gain_db": [20, 40]}
    scenes = {**common, "scenarios": [str(tiny)], "snr_db": [-10, 0]}
    return {
        "imaging": lambda: Suite(**scenes),
        "efficiency": lambda: Suite(kind="efficiency", **rooms),
        "detection": lambda: DetectionSuite(
            **{**scenes, "estimators": ["blob", "music2d"]}, detectors=["ca"], maps=["homogeneous"]
        ),
    }[request.param]()


def tables(folder):
    return {path.name: path.read_bytes() for path in folder.glob("*.parquet")} | {
        "csv": (folder / "results.csv").read_bytes()
    }


def test_scores_come_back_bit_for_bit_without_any_plugin_and_none_differs_without_a_change(
    suite, tmp_path, monkeypatch
):
    run(suite, out=tmp_path / "run")
    before = tables(tmp_path / "run")
    unchanged = rescore(tmp_path / "run")
    assert (unchanged.n_scored > 0, unchanged.n_changed, unchanged.changes) == (True, 0, [])
    assert tables(tmp_path / "run") == before
    spoilt = pd.read_parquet(tmp_path / "run" / "results.parquet")
    failed_rows = spoilt["status"] == "error"
    for name in [*SCORES, *(MEASURED if suite.kind == "efficiency" else ())]:
        spoilt[name] = ~spoilt[name] if spoilt[name].dtype == bool else spoilt[name] + 1
    spoilt.loc[spoilt["status"] == "ok", "deviation"] = np.nan
    spoilt.attrs = {}
    spoilt.to_parquet(tmp_path / "run" / "results.parquet", index=False)
    hide_estimators(monkeypatch)
    assert not entries("estimator")
    rescored = rescore(tmp_path / "run")
    after = tables(tmp_path / "run")
    records = pd.read_parquet(tmp_path / "run" / "results.parquet")
    imaged = records["deviation"].notna() & ~failed_rows
    assert rescored.n_scored == rescored.n_changed == imaged.sum() > 0
    if suite.kind != "efficiency":
        assert after == before
    else:  # what failed was spoilt as well, and nobody can score it
        pd.testing.assert_frame_equal(records[~imaged], spoilt[~imaged])
        del after["results.parquet"], after["csv"], before["results.parquet"], before["csv"]
        assert after == before


@pytest.fixture
def street(plugins, tiny):
    """Suite that images one small scene."""
    estimators = ["seer", "blob", "trouble"]
    return Suite(name="test", scenarios=[str(tiny)], estimators=estimators, snr_db=[0], trials=2)


@pytest.fixture
def done(street, run_once):
    """Return a folder that holds its run."""
    return run_once("street", street)


def test_changes_are_counted_by_column_with_the_largest(done):
    records = pd.read_parquet(done / "results.parquet")
    records.attrs = {}
    records.loc[[0, 1], "gospa_m"] += [0.25, -0.5]
    records.loc[3, "recall"] = np.nan
    records.to_parquet(done / "results.parquet", index=False)
    rescored = rescore(done)
    assert (rescored.n_scored, rescored.n_changed) == (4, 3)
    gospa, recall = rescored.changes
    assert (gospa.column, gospa.n_rows, gospa.n_filled) == ("gospa_m", 2, 0)
    assert gospa.largest == pytest.approx(0.5)
    assert recall == Change("recall", 0, 0.0, 1)


def test_the_manifest_has_the_metric_and_the_call_and_a_run_goes_on(street, tmp_path, monkeypatch):
    with monkeypatch.context() as patched:
        patched.setattr(Paper, "version", 0)
        run(street, out=tmp_path / "run")
    before = read_manifest(tmp_path / "run")
    rescore(tmp_path / "run")
    after = read_manifest(tmp_path / "run")
    versions = [found["scores"]["metrics"]["paper"]["version"] for found in (before, after)]
    assert versions == [0, Paper.version]
    assert [session.get("rescored") for session in after["sessions"]] == [None, 4]
    changed = {key for key in after if after[key] != before[key]}
    assert changed == {"scores", "sessions"}
    assert len(run(street, trials=3, out=tmp_path / "run")) == 9


def test_a_run_rescored_by_a_further_metric_goes_on_with_that_metric(street, done):
    rescore(done, ["repository"])
    with pytest.raises(
        InputError, match="metric repository: version 1, wanted: not at all; add --metric repo"
    ):
        run(street, trials=3, out=done)
    rows = run(street, trials=3, out=done, metrics=["repository"])
    assert np.isfinite(rows.loc[rows["estimator"] != "trouble", "velocity"]).all()


def test_a_killed_run_is_scored_with_the_rows_of_its_journal(street, done, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(Run, "save", lambda *_: None)
        run(street, out=tmp_path / "run")
    assert not (tmp_path / "run" / "results.parquet").exists()
    assert rescore(tmp_path / "run").n_scored == 4
    assert not (tmp_path / "run" / "journal.jsonl").exists()
    folders = (tmp_path / "run", done)
    found = [pd.read_parquet(folder / "results.parquet").drop(columns=TIMES) for folder in folders]
    pd.testing.assert_frame_equal(*found)


@pytest.fixture
def drawn(plugins, room_file, run_once):
    """Folder of a run that drew its scatterers."""
    rooms = {"scenarios": [str(room_file)], "snr_gain_db": [40], "trials": 3}
    return run_once("drawn", Suite(kind="efficiency", name="test", estimators=["seer", "blob"], **rooms))


def test_draws_that_are_not_kept_are_drawn_again_and_refused_if_they_would_be_others(drawn, monkeypatch):
    before = tables(drawn)
    (drawn / "draws.parquet").unlink()
    assert rescore(drawn).n_changed == 0
    assert {**before, **tables(drawn)} == before
    monkeypatch.setattr("isacbench.bench.kinds.efficiency.MARGIN_CELLS", 0.75)
    (drawn / "draws.parquet").unlink(missing_ok=True)
    with pytest.raises(
        InputError, match="room, trial 0 are not stored, and this isacbench would draw others"
    ):
        rescore(drawn)


def test_kept_draws_count_even_if_they_would_be_drawn_otherwise_now(drawn, monkeypatch):
    monkeypatch.setattr("isacbench.bench.kinds.efficiency.MARGIN_CELLS", 0.75)
    assert rescore(drawn).n_changed == 0


def lose_all(folder):
    (folder / "clouds.parquet").unlink()


def lose_one(folder):
    clouds = pd.read_parquet(folder / "clouds.parquet")
    clouds.attrs = {}
    clouds.iloc[1:].to_parquet(folder / "clouds.parquet", index=False)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lose_all, "4 of 4 clouds are missing or damaged"),
        (lose_one, "1 of 4 clouds are missing or damaged"),
    ],
)
def test_missing_and_damaged_clouds_are_refused_and_nothing_changes(done, tmp_path, damage, message):
    damage(done)
    shutil.copytree(done, tmp_path / "copy")
    with pytest.raises(InputError, match=message):
        rescore(done)
    names = [path.name for path in (tmp_path / "copy").iterdir() if path.name != ".lock"]
    assert all((tmp_path / "copy" / x).read_bytes() == (done / x).read_bytes() for x in names)


def test_a_run_that_is_written_into_is_refused(done):
    with open_folder(done), pytest.raises(InputError, match="another run is writing into it"):
        rescore(done)


def test_a_folder_without_a_run_is_refused_and_stays_as_it_is(tmp_path):
    with pytest.raises(InputError, match=r"not the folder of a run, manifest\.json missing"):
        rescore(tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_score_that_rows_had_not_is_told_as_filled_in():
    assert str(Change("recall", 0, 0.0, 36)) == "recall: 36 rows filled in"
    assert str(Change("recall", 2, 0.5, 36)) == "recall: 36 rows filled in; 2 rows, by at most 0.5"
    assert str(Change("recall", 2, 0.5)) == "recall: 2 rows, by at most 0.5"
