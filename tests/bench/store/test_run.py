"""A run read back: rows as a table, clouds and truths by row or by key."""

import json
import shutil

import numpy as np
import pandas as pd
import pytest

from isacbench import load_run
from isacbench.bench.cells.record import SCORED
from isacbench.bench.run.runner import run_suite
from isacbench.bench.store.run import CellKey, Run
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputError
from isacbench.plugins.scoring import score


@pytest.fixture
def written(plugins, tiny, shelf, remembered):
    """A run with images, images of nothing, and failures; and its folder, which is not to be written to."""
    if not remembered:
        suite = Suite(
            name="test",
            scenarios=[str(tiny)],
            estimators=["seer", "blob[n=1]", "trouble[kind=empty]", "trouble"],
            snr_db=[0, 10],
            trials=2,
        )
        remembered["results"] = run_suite(suite, out=shelf / "mine")
    return remembered["results"], shelf / "mine"


@pytest.fixture
def copied(written, tmp_path):
    """Folder of a run that may be written to."""
    return shutil.copytree(written[1], tmp_path / "mine")


def test_rows_and_manifest_are_those_of_the_run(written):
    results, folder = written
    stored = load_run(str(folder))
    pd.testing.assert_frame_equal(stored.rows, results.rows)
    assert stored.manifest["suite"]["name"] == "test"


def test_a_run_is_told_by_what_became_of_its_cells(copied, monkeypatch):
    monkeypatch.chdir(copied.parent)
    title, facts = repr(load_run("mine")).split("\n", maxsplit=1)
    assert title == "Run of 'test': 16 rows in 'mine'"
    assert facts.startswith("  status 8 ok, 4 no_detection, 4 error; scenarios tiny; ")
    assert "estimators seer, blob, trouble in 4 variants;\n  SNR 0 to 10 dB; trials 2; started " in facts


def test_every_form_of_a_row_gives_its_cloud(written):
    stored = load_run(written[1])
    for position, row in enumerate(stored.rows.itertuples()):
        if row.status not in SCORED:
            continue
        cloud = stored.cloud(row)
        assert len(cloud) == row.n_estimated
        key = CellKey(row.scenario, row.estimator, row.params, row.snr_db, row.trial)
        series = stored.rows.iloc[position]
        for form in (series, series.to_dict(), stored.rows.iloc[[position]], key, tuple(key)):
            np.testing.assert_array_equal(stored.cloud(form).to_array(), cloud.to_array())
        np.testing.assert_array_equal(stored.clouds[tuple(key)].to_array(), cloud.to_array())


def test_a_part_of_the_key_is_enough_where_one_row_has_it(written):
    stored = load_run(written[1])
    cloud = stored.cloud(estimator="seer", snr_db=10, trial=1)
    np.testing.assert_array_equal(cloud.to_array(), stored.truth("tiny").to_array())


def test_clouds_are_those_of_the_cells_that_were_imaged_in_the_order_of_the_rows(written):
    stored = load_run(written[1])
    imaged = stored.rows[stored.rows["status"].isin(SCORED)]
    assert [key.estimator for key in stored.clouds] == imaged["estimator"].tolist()
    assert len(stored.clouds) == 12
    assert repr(stored.clouds).startswith("Clouds of 12 cells")


def test_clouds_are_read_when_they_are_asked_for(copied):
    stored = load_run(copied)
    (copied / "clouds.parquet").write_text("damaged")
    assert len(stored.rows) == 16
    with pytest.raises(InputError, match=r"damaged run: ValueError: clouds\.parquet"):
        stored.cloud(stored.rows.iloc[0])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"estimator": "sear"},
            r"0 rows have estimator = 'sear'; .* of the run are .*estimator seer, blob, ",
        ),
        ({"snr_db": 5}, r"0 rows have snr_db = 5; .*snr_db 0.0, 10.0"),
        ({"estimator": "blob", "params": "{}"}, r"0 rows have estimator = 'blob' and params = '{}'"),
        ({"estimator": "seer", "snr_db": 0}, r"2 rows have .* of these rows are .*snr_db 0.0; trial 0, 1$"),
        ({}, r"16 rows have any key; give a key"),
        (
            {"params": '{"kind":"raise"}', "snr_db": 0, "trial": 0},
            r"no luck .*; allowed are ok and no_det",
        ),
    ],
)
def test_a_key_of_no_cloud_is_refused_with_what_there_is(written, given, message):
    with pytest.raises(InputError, match=f"^{written[1]}: .*{message}"):
        load_run(written[1]).cloud(**given)


@pytest.mark.parametrize("row", ["tiny", (1, 2), {"scenario": "tiny"}, pd.DataFrame()])
def test_what_is_no_row_is_refused(written, row):
    with pytest.raises(InputError, match=r"expected one row of the run's table, .*; got a"):
        load_run(written[1]).cloud(row)


def test_a_cloud_that_was_not_kept_is_told(copied):
    (copied / "clouds.parquet").unlink()
    stored = load_run(copied)
    with pytest.raises(InputError, match=r"seer on tiny at 0 dB, trial 0 has no cloud: it is missing"):
        stored.cloud(stored.rows.iloc[0])


def test_scores_follow_from_the_scenario_and_the_cloud_of_a_row(written):
    stored = load_run(written[1])
    for row in stored.rows[stored.rows["status"].isin(SCORED)].itertuples():
        scenario = stored.scenario(row)
        velocity_bin_mps = scenario.system.velocity_bin_mps
        scores = score(
            stored.truth(row), stored.cloud(row), region=scenario.region, velocity_bin_mps=velocity_bin_mps
        )
        assert scores["deviation"] == row.deviation


def test_a_scenario_is_found_by_its_name_as_well(written):
    stored = load_run(written[1])
    assert len(stored.truth("tiny")) == 3
    with pytest.raises(InputError, match=r"unknown scenario 'tony': did you mean 'tiny'\?"):
        stored.scenario("tony")


def test_a_run_that_was_ended_early_is_read_from_its_journal(plugins, tiny, tmp_path, monkeypatch):
    suite = Suite(name="test", scenarios=[str(tiny)], estimators=["seer"], snr_db=[0], trials=2)
    monkeypatch.setattr(Run, "save", lambda *_: None)
    run_suite(suite, out=tmp_path / "killed")
    stored = load_run(tmp_path / "killed")
    assert not (stored.folder / "results.parquet").exists()
    assert len(stored.rows) == 2
    assert len(stored.cloud(trial=1)) == 3


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda folder, _: (folder / "results.parquet").unlink(), r"no rows, results\.parquet is missing"),
        (lambda folder, _: (folder / "journal.jsonl").touch(), "the run is not finished; resume it"),
        (lambda _, manifest: manifest.pop("seed"), r"manifest\.json: seed missing.*run it again"),
        (lambda _, manifest: manifest["environments"].pop("e1"), r"manifest\.json: e1 missing"),
    ],
)
def test_a_run_that_is_not_finished_or_does_not_say_what_it_measured_is_not_compared(
    made_run, written_run, spoil, message
):
    records, manifest = made_run()
    folder = written_run("run", records, manifest)
    assert Run.open(folder).require_finished().manifest == manifest
    spoil(folder, manifest)
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(InputError, match=message):
        Run.open(folder).require_finished()
