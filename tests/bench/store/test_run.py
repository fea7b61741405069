"""A run read back: rows as a table, clouds and truths by row or by key."""

import json
import shutil

import numpy as np
import pandas as pd
import pytest

import isacbench
from isacbench import load_run
from isacbench.bench.cells.rows import SCORED
from isacbench.bench.kinds.detection import DetectionSuite
from isacbench.bench.kinds.resolution import ResolutionSuite
from isacbench.bench.run.runner import run_suite
from isacbench.bench.store.run import CellKey, Run
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputError
from isacbench.model.echo import observe_echo


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


def test_a_run_is_read_back_as_it_was_written(written):
    results, folder = written
    again = load_run(str(folder))
    pd.testing.assert_frame_equal(again.rows, results.rows)
    np.testing.assert_array_equal(np.concatenate(again.points), np.concatenate(results.points))
    assert again.suite == results.suite
    assert not again.manifest["interrupted"]
    assert again.manifest == results.manifest
    for name, scenario in results.scenarios.items():
        np.testing.assert_array_equal(
            observe_echo(again.scenarios[name], 0).cells, observe_echo(scenario, 0).cells
        )
    table = pd.read_csv(folder / "results.csv", keep_default_na=False, na_values={"deviation": [""]})
    assert table.columns.tolist() == results.rows.columns.tolist()
    assert table["estimator"].tolist() == results.rows["estimator"].tolist()
    np.testing.assert_allclose(table["deviation"], results.rows["deviation"], rtol=1e-12)


def test_a_study_is_read_back_with_its_suite_its_columns_and_what_it_drew(plugins, room_file, tmp_path):
    suite = ResolutionSuite(
        name="test",
        scenarios=[str(room_file)],
        estimators=["seer"],
        dimensions=["u"],
        separations_cells=[0.5],
        phases_deg=[90],
        snr_gain_db=[60],
        trials=2,
    )
    results = run_suite(suite, out=tmp_path / "run")
    again = load_run(tmp_path / "run")
    assert again.suite == suite
    pd.testing.assert_frame_equal(again.rows, results.rows)
    pd.testing.assert_frame_equal(again.draws, results.draws)
    assert len(again.draws) == 2 * 2
    assert again.rows["resolved"].dtype == bool
    assert list(again.scenarios) == ["room"]
    # Each trial has the truth that it drew.
    truths = [again.truth(row) for row in again.rows.itertuples()]
    assert [len(truth) for truth in truths] == [2, 2]
    assert not np.allclose(truths[0].xyz, truths[1].xyz)
    for row, truth in zip(again.rows.itertuples(), truths, strict=True):
        np.testing.assert_array_equal(again.cloud(row).xyz, truth.xyz)


def test_a_detector_on_a_map_has_its_package_in_the_manifest_and_neither_cloud_nor_scenario(
    plugins, tiny, tmp_path
):
    suite = DetectionSuite(
        name="test",
        scenarios=[str(tiny)],
        estimators=["blob"],
        detectors=["level"],
        maps=["homogeneous"],
        snr_gain_db=[20],
        trials=1,
    )
    run_suite(suite, out=tmp_path / "run")
    manifest = json.loads((tmp_path / "run" / "manifest.json").read_text(encoding="utf-8"))
    assert [entry["name"] for entry in manifest["estimators"]] == ["level", "blob"]
    assert all("test-plugins" in entry["packages"] for entry in manifest["estimators"])
    assert not (tmp_path / "run" / "draws.parquet").exists()
    stored = load_run(tmp_path / "run")
    row = stored.rows.set_index("scenario").loc["homogeneous"].to_dict() | {"scenario": "homogeneous"}
    for ask in (stored.cloud, stored.scenario):
        with pytest.raises(InputError, match=r"level on homogeneous .* the row is the test of a detector"):
            ask(row)
    assert [key.scenario for key in stored.clouds] == ["tiny"]


def test_the_manifest_says_what_ran_on_what(written):
    manifest = json.loads((written[1] / "manifest.json").read_text(encoding="utf-8"))
    assert manifest["suite"]["estimators"][1] == "blob[n=1]"
    assert manifest["seed"] == 0
    assert manifest["estimators"][1]["params"]["n"] == 1
    assert manifest["estimators"][1]["packages"]["test-plugins"]["version"] == "1.0"
    assert manifest["packages"]["numpy"] == np.__version__
    assert manifest["blas_threads"] == 1
    assert manifest["wall_time_s"] > 0
    assert manifest["processor"]
    assert {"isacbench", "git", "argv", "started", "python", "platform", "cores", "blas"} <= set(manifest)


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


@pytest.mark.parametrize("error", [PermissionError(13, "Permission denied"), MemoryError("no more")])
def test_what_the_system_does_not_let_us_read_is_not_called_damaged(written, monkeypatch, error):
    def refuse(*_, **__):
        raise error

    _, folder = written
    monkeypatch.setattr(pd, "read_parquet", refuse)
    for read in (load_run, isacbench.rank):
        with pytest.raises(InputError, match=r"results\.parquet: cannot be read: ") as told:
            read(folder)
        assert "damaged" not in str(told.value)


@pytest.mark.parametrize("name", ["a" * 300, "x\udcff"], ids=["too long", "no UTF-8"])
def test_odd_names_of_folders_are_refused_in_a_line_and_no_sound_run_is_called_damaged(
    written, tmp_path, name
):
    results, folder = written
    with pytest.raises(InputError, match=r"File name too long|its name is not UTF-8; rename it"):
        run_suite(results.suite, out=tmp_path / name)
    if len(name) < 100:
        shutil.copytree(folder, tmp_path / name)
        for read in (load_run, isacbench.rank):
            with pytest.raises(InputError, match="its name is not UTF-8; rename it"):
                read(tmp_path / name)
