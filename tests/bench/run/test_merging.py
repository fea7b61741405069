import json
import shutil

import numpy as np
import pandas as pd
import pytest

from isacbench.bench.cells.plan import load_job
from isacbench.bench.cells.rows import TIMES
from isacbench.bench.kinds.detection import DetectionSuite
from isacbench.bench.kinds.population import PopulationSuite
from isacbench.bench.kinds.resolution import ResolutionSuite
from isacbench.bench.run.merging import merge
from isacbench.bench.run.runner import run
from isacbench.bench.store.manifest import describe_run, read_manifest, restore_plan
from isacbench.bench.store.run import Run
from isacbench.bench.suites.scenario_digest import digest
from isacbench.errors import InputError
from isacbench.plugins.discovery import entries
from tests.conftest import ROOM, TINY, TINY_POINTS, hide_estimators


@pytest.fixture(scope="module")
def shelf(tmp_path_factory):
    """Return a folder of scenarios, which nobody changes, and of runs, to be copied."""
    folder = tmp_path_factory.mktemp("runs")
    for name, text in (("tiny.toml", TINY), ("tiny.csv", TINY_POINTS), ("room.toml", ROOM)):
        (folder / name).write_text(text)
    shutil.copytree(folder, folder / "elsewhere")
    return folder


@pytest.fixture
def tiny(shelf):
    return shelf / "tiny.toml"


@pytest.fixture
def put_run(shelf):
    """Return a function that puts a run, or a part of it, into a folder."""

    def put(suite, folder, shard=None):
        made = shelf / digest([suite.model_dump(mode="json"), shard])
        if not made.exists():
            run(suite, out=made, shard=shard)
        shutil.copytree(made, folder)

    return put


@pytest.fixture
def halves(suite, shelf, put_run, tmp_path):
    """Return the folders of the two halves of the suite, whose scenario has another path in each."""
    folders = [tmp_path / "1", tmp_path / "2"]
    put_run(suite, folders[0], "1/2")
    put_run(suite.replace(scenarios=[str(shelf / "elsewhere" / "tiny.toml")]), folders[1], "2/2")
    return folders


@pytest.fixture(params=["resolution", "detection"])
def studied(request, plugins, shelf):
    """Suite of a study that draws scatterers, and of one whose rows are not all images."""
    common = {"name": "test", "estimators": ["blob"], "trials": 2}
    if request.param == "resolution":
        return ResolutionSuite(
            **common,
            scenarios=[str(shelf / "room.toml")],
            dimensions=["u", "range"],
            separations_cells=[1],
            phases_deg=[90],
            snr_gain_db=[20],
        )
    return DetectionSuite(
        **common,
        scenarios=[str(shelf / "tiny.toml")],
        detectors=["level", "ca"],
        maps=["interferers"],
        pfa=[1e-2],
        snr_db=[-10],
    )


def files(folder):
    """Tables of a run as they are on disk, times left out."""
    records = pd.read_parquet(folder / "results.parquet").drop(columns=TIMES)
    others = ("clouds.parquet", "truth.parquet", "draws.parquet")
    return records.to_csv(), {
        name: (folder / name).read_bytes() for name in others if (folder / name).exists()
    }


def forget_plugins(monkeypatch):
    """Leave no plugin to whoever asks for one."""
    hide_estimators(monkeypatch)
    assert not entries("estimator")


def test_all_shards_together_are_the_undisturbed_run_and_need_no_plugin(
    studied, put_run, tmp_path, monkeypatch
):
    put_run(studied, tmp_path / "whole")
    shards = [tmp_path / f"shard{k}" for k in (2, 1)]
    for folder in shards:
        run(studied, out=folder, shard=f"{folder.name[-1]}/2")
    job = load_job(studied)
    scenes = describe_run(job)["scenes"]
    forget_plugins(monkeypatch)
    merged = merge(shards, tmp_path / "merged")
    assert files(tmp_path / "merged") == files(tmp_path / "whole")
    assert (len(merged.run.rows), merged.gaps) == (merged.n_cells, [])
    columns = pd.read_csv(tmp_path / "merged" / "results.csv").columns
    assert columns.equals(pd.read_csv(tmp_path / "whole" / "results.csv").columns)
    (shards[0] / "draws.parquet").unlink(missing_ok=True)  # a part that was killed has none
    merge(shards, tmp_path / "again")
    assert files(tmp_path / "again") == files(tmp_path / "whole")
    # The outline of a plan places rows as the plan does.
    manifest = read_manifest(tmp_path / "whole")
    again = restore_plan(manifest)
    assert manifest["scenes"] == scenes
    records = Run.open(tmp_path / "whole").rows
    for one in (job.plan, again):
        np.testing.assert_array_equal(one.positions(records), np.arange(again.n_cells))


def test_what_is_missing_is_told_and_a_further_run_makes_it(suite, put_run, tmp_path):
    for k in (1, 3):
        put_run(suite, tmp_path / str(k), f"{k}/3")
    merged = merge([tmp_path / "1", tmp_path / "3"], tmp_path / "merged")
    assert (len(merged.run.rows), merged.n_cells) == (8, 12)
    assert [(gap.scenario, gap.estimator, gap.n_cells, gap.trials) for gap in merged.gaps] == [
        ("tiny", "blob", 2, (1,)),
        ("tiny", "seer", 2, (1,)),
    ]
    done = run(suite, out=tmp_path / "merged")
    put_run(suite, tmp_path / "whole")
    assert len(done) == 12
    assert files(tmp_path / "merged") == files(tmp_path / "whole")


def population(tiny, **changes):
    """Suite of a population with one scene."""
    keys = {"name": "p", "version": 1, "scenarios": [str(tiny)], "snr_db": [0.0], "trials": 1}
    return PopulationSuite(**{**keys, "estimators": ["blob", "seer"], **changes})


def change_manifest(folder, change):
    manifest = read_manifest(folder)
    change(manifest)
    (folder / "manifest.json").write_text(json.dumps(manifest))


def test_a_third_party_adds_its_estimator_to_a_population_and_nobody_else_needs_it(
    plugins, tiny, put_run, tmp_path, monkeypatch
):
    put_run(population(tiny), tmp_path / "ours")
    put_run(population(tiny, estimators=["blob[n=7]", "seer"]), tmp_path / "theirs")
    put_run(population(tiny, estimators=["blob", "seer", "blob[n=7]"]), tmp_path / "whole")
    forget_plugins(monkeypatch)
    merged = merge([tmp_path / "ours", tmp_path / "theirs"], tmp_path / "merged")
    assert merged.gaps == []
    assert Run.open(tmp_path / "merged").suite.estimators == ("blob", "seer", "blob[n=7]")
    assert files(tmp_path / "merged") == files(tmp_path / "whole")
    keys = ("estimators", "scenes", "suite")
    both = [read_manifest(tmp_path / name) for name in ("merged", "whole")]
    assert [both[0][key] for key in keys] == [both[1][key] for key in keys]
    change_manifest(tmp_path / "theirs", lambda manifest: manifest["suite"].update(version=2))
    with pytest.raises(InputError, match=r"version differs \(1, 2\)"):
        merge([tmp_path / "ours", tmp_path / "theirs"], tmp_path / "refused")


def test_the_manifest_has_the_sessions_of_all_parts_and_their_environments(suite, halves, tmp_path):
    merged = merge(halves, tmp_path / "merged")
    assert merged.gaps == []
    assert Run.open(tmp_path / "merged").suite == suite
    manifest = read_manifest(tmp_path / "merged")
    assert [session.get("shard") for session in manifest["sessions"]] == ["1/2", "2/2", None]
    assert manifest["sessions"][-1]["merged"] == [str(folder) for folder in halves]
    assert set(manifest["environments"]) == set(merged.run.rows["environment"])
    assert not manifest["interrupted"]
    assert manifest["seed"] == 1
    # Equal rows of a cell count once.
    again = merge([tmp_path / "merged", halves[0]], tmp_path / "again")
    assert len(again.run.rows) == again.n_cells == 12


def test_rows_and_clouds_that_disagree_about_a_cell_are_refused_with_its_name(suite, put_run, tmp_path):
    for name in ("1", "rows", "clouds"):
        put_run(suite, tmp_path / name)
    for name, file, row, column in (("rows", "results", 3, "deviation"), ("clouds", "clouds", 0, "x")):
        path = tmp_path / name / f"{file}.parquet"
        table = pd.read_parquet(path)
        table.attrs = {}
        table.loc[row, column] += 1
        table.to_parquet(path, index=False)
    for name, cell in (
        ("rows", "seer on tiny at 0 dB, trial 0"),
        ("clouds", "blob on tiny at -10 dB, trial 0"),
    ):
        with pytest.raises(InputError, match=f"two parts disagree about {cell}"):
            merge([tmp_path / "1", tmp_path / name], tmp_path / "merged")
        assert not (tmp_path / "merged").exists()


def test_runs_that_do_not_belong_together_are_refused_with_what_differs(suite, tiny, halves, tmp_path):
    whole, refused = (tmp_path / "2" / "manifest.json").read_text(), tmp_path / "merged"
    for change, message in (
        (
            lambda it: it["suite"].update(seed=2),
            r"1 and \S+2: seed differs \(1, 2\); only parts of one suite",
        ),
        (lambda it: it["suite"].update(name="other"), r"suite differs \(test, other\)"),
        (
            lambda it: it["suite"].update(snr_db=None, snr_gain_db=[3.0]),
            r"1 and \S+2: snr_gain_db differs \(none, \(3.0,\)\); only parts .* estimators alone",
        ),
        (lambda it: it["suite"].update(trials=4), r"trials differs \(3, 4\)"),
        (lambda it: it["scenarios"]["tiny"].update(content="other"), "content of scenario 'tiny'"),
        (
            lambda it: it["scores"]["metrics"]["paper"].update(version=0),
            r"metric 'paper' differs \(.*'version': 1",
        ),
        (lambda it: it.pop("scenes"), r"manifest\.json: scenes missing; run it again"),
    ):
        (halves[1] / "manifest.json").write_text(whole)
        change_manifest(halves[1], change)
        with pytest.raises(InputError, match=message):
            merge(halves, refused)
    run(population(tiny, name="test", seed=1, estimators=["seer"]), out=tmp_path / "3")
    with pytest.raises(InputError, match=r"kind differs \(imaging, population\)"):
        merge([halves[0], tmp_path / "3"], refused)
    assert not refused.exists()


def test_other_versions_are_refused_unless_they_may_be_mixed(suite, halves, tmp_path, monkeypatch):
    monkeypatch.setattr("isacbench.bench.cells.provenance.package_version", lambda package: "0.0")
    shutil.rmtree(halves[1])
    run(suite, out=halves[1], shard="2/2")
    with pytest.raises(
        InputError, match=rf"blob: .* by numpy {np.__version__} instead of 0\.0.*--mix-versions"
    ):
        merge(halves, tmp_path / "merged")
    merged = merge(halves, tmp_path / "merged", mix_versions=True)
    assert merged.run.rows["environment"].nunique() == 2
    assert merged.gaps == []


def test_damaged_and_occupied_folders_are_refused(halves, tmp_path):
    with pytest.raises(InputError, match="holds a run; give a new folder"):
        merge(halves[:1], halves[0])
    (halves[1] / "clouds.parquet").unlink()
    with pytest.raises(InputError, match="4 of 4 clouds are missing or damaged"):
        merge(halves[1:], tmp_path / "merged")
