import json
import os
import shutil

import numpy as np
import pandas as pd
import pytest

import isacbench
from isacbench import load_run
from isacbench.bench.kinds.detection import DetectionSuite
from isacbench.bench.kinds.resolution import ResolutionSuite
from isacbench.bench.run.runner import run_suite
from isacbench.bench.store.run import Run
from isacbench.bench.store.run_folder import default_folder, open_folder, replacing
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputError
from isacbench.model.echo import observe_echo


@pytest.fixture
def written(plugins, tiny, tmp_path, shelf, remembered):
    """Return the results of a run, and a folder that holds it."""
    suite = Suite(
        name="test",
        scenarios=[str(tiny), "street"],
        estimators=["blob[n=5]", "seer", "trouble", "trouble[kind=empty]"],
        snr_db=[0],
        trials=1,
    )
    if not remembered:
        remembered["results"] = run_suite(suite, out=shelf / "made")
    return remembered["results"], shutil.copytree(shelf / "made", tmp_path / "results" / "mine")


def test_a_run_is_read_back_as_it_was_written(written):
    results, folder = written
    again = Run.open(folder)
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
    again = Run.open(tmp_path / "run")
    assert again.suite == suite
    pd.testing.assert_frame_equal(again.rows, results.rows)
    pd.testing.assert_frame_equal(again.draws, results.draws)
    assert len(again.draws) == 2 * 2
    assert again.rows["resolved"].dtype == bool
    assert list(again.scenarios) == ["room"]
    # Each trial has the truth that it drew.
    stored = load_run(tmp_path / "run")
    truths = [stored.truth(row) for row in stored.rows.itertuples()]
    assert [len(truth) for truth in truths] == [2, 2]
    assert not np.allclose(truths[0].xyz, truths[1].xyz)
    for row, truth in zip(stored.rows.itertuples(), truths, strict=True):
        np.testing.assert_array_equal(stored.cloud(row).xyz, truth.xyz)


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
    assert manifest["suite"]["estimators"][0] == "blob[n=5]"
    assert manifest["seed"] == 0
    assert manifest["estimators"][0]["params"]["n"] == 5
    assert manifest["estimators"][0]["packages"]["test-plugins"]["version"] == "1.0"
    assert manifest["packages"]["numpy"] == np.__version__
    assert manifest["blas_threads"] == 1
    assert manifest["wall_time_s"] > 0
    assert manifest["processor"]
    assert {"isacbench", "git", "argv", "started", "python", "platform", "cores", "blas"} <= set(manifest)


def test_a_folder_of_something_else_is_refused_and_left_alone(tmp_path):
    (tmp_path / "thesis.txt").write_text("precious")
    with pytest.raises(InputError, match="is not the folder of a run"), open_folder(tmp_path):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_an_empty_existing_folder_is_taken_and_stays(tmp_path):
    with open_folder(tmp_path) as folder:
        assert folder == tmp_path
    assert tmp_path.is_dir()


def test_a_file_in_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be created or read"), open_folder(tmp_path / "file"):
        pass


def test_a_new_folder_that_stays_empty_goes_away(tmp_path):
    with pytest.raises(RuntimeError), open_folder(tmp_path / "run"):
        raise RuntimeError
    assert not (tmp_path / "run").exists()


def test_a_folder_that_is_written_into_is_refused_with_who_does(tmp_path):
    with (
        open_folder(tmp_path / "run"),
        pytest.raises(InputError, match=rf"another run is writing into it \(process {os.getpid()} on "),
        open_folder(tmp_path / "run"),
    ):
        pass


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("old")
    with pytest.raises(UnicodeEncodeError), replacing(path) as temporary:
        temporary.write_text("half \ud800", encoding="utf-8")
    assert path.read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["table.csv"]
    with replacing(path) as temporary:
        temporary.write_text("new")
    assert path.read_text() == "new"


def test_the_default_folder_is_named_after_suite_and_time():
    assert default_folder("quick").match("results/quick-20??????-??????")


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
