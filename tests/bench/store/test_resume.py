"""Going on with a run: nothing twice, nothing lost, nothing mixed, whatever has happened to the folder."""

import json
import random
import shutil
import warnings
from functools import cache
from unittest.mock import Mock

import pandas as pd
import pytest

from isacbench.bench.cells.rows import TIMES
from isacbench.bench.run.runner import RunOptions, run_suite
from isacbench.bench.store.run import Run
from isacbench.bench.store.run_folder import Journal
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputError, InputWarning
from isacbench.metrics.paper import Paper
from isacbench.plugins import discovery
from isacbench.plugins.discovery import isolated_plugins, load_plugin_file

SLOW = pytest.mark.slow

FAILING = "wreck[kind=raise_]"


@pytest.fixture
def suite(wreck, tiny):
    return Suite(
        name="test",
        scenarios=[str(tiny)],
        estimators=["good[n=2]", FAILING, "dice"],
        snr_db=[0, 10],
        trials=2,
    )


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "run"


class KilledError(Exception):
    """What ends a run without a chance to write its tables."""


def go(suite, folder, *rerun, **options):
    """Run and return the table and the number of cells that were made."""
    calls = []
    results = run_suite(
        suite,
        folder,
        progress=lambda *done: calls.append(done),
        options=RunOptions(rerun=rerun, **options),
    )
    return results, len(calls)


def kill_after(suite, folder, n_cells, *rerun):
    """Run up to a cell, whose row is the last one in the journal."""

    def progress(done, total):
        nonlocal n_cells
        n_cells -= 1
        if n_cells == 0:
            raise KilledError

    with pytest.raises(KilledError):
        run_suite(suite, folder, progress, RunOptions(rerun=rerun))


def table(folder):
    """Everything of a folder's tables that a second run must reproduce."""
    records = pd.read_csv(folder / "results.csv", dtype=str).drop(columns=TIMES)
    return records.to_csv(), pd.read_parquet(folder / "clouds.parquet").to_csv()


remembered_table = cache(table)


@pytest.fixture
def complete(suite, shelf):
    """Return the folder of a complete run, to be copied."""
    path = shelf / "complete"
    if not path.exists():
        go(suite, path)
    return path


@pytest.fixture
def finished(complete, folder):
    """Return a folder with a complete run."""
    return shutil.copytree(complete, folder)


@pytest.fixture
def undisturbed(complete):
    return remembered_table(complete)


def test_a_run_that_is_killed_again_and_again_ends_in_the_same_table(suite, folder, undisturbed):
    for n_cells, n_rows in ((1, 1), (5, 6), (6, 12)):
        kill_after(suite, folder, n_cells)
        assert len(Run.open(folder).rows) == n_rows
    assert go(suite, folder)[1] == 0
    assert table(folder) == undisturbed
    assert not (folder / "journal.jsonl").exists()


# After one step is before the next, but for what the step itself has left to be tidied up.
@pytest.mark.parametrize(
    ("step", "before"),
    [
        pytest.param(step, before, marks=() if (step, before) in ((1, True), (4, False)) else SLOW)
        for step in range(8)
        for before in (True, False)
    ],
)
def test_a_run_that_is_killed_while_it_writes_its_tables_loses_no_row(
    suite, folder, undisturbed, monkeypatch, step, before
):
    kill_after(suite, folder, 5)
    replace, n_calls = type(folder).replace, 0

    def replace_or_die(path, target):
        nonlocal n_calls
        n_calls += 1
        if before and n_calls > step:
            raise KilledError
        replace(path, target)
        if n_calls > step:
            raise KilledError

    with monkeypatch.context() as patch:
        patch.setattr(type(folder), "replace", replace_or_die)
        with pytest.raises(KilledError):
            go(suite, folder)
    _, n_made = go(suite, folder)
    # The first steps are those before the first cell: writing down what the last run left.
    assert n_made == (7 if n_calls <= 4 else 0)
    assert table(folder) == undisturbed


def test_a_run_may_grow_and_be_put_into_another_order(suite, folder, tmp_path, finished):
    estimators = ["dice", "good[n=1]", "good[n=2]", FAILING]
    wider = suite.replace(estimators=estimators, trials=4, snr_db=[10, -5, 0])
    results, n_made = go(wider, folder)
    assert n_made == len(results.rows) - 12
    go(wider, tmp_path / "at once")
    assert table(folder) == table(tmp_path / "at once")


@pytest.mark.parametrize("rerun", [(), pytest.param(("all",), marks=SLOW)])
def test_rows_that_would_be_lost_are_refused_and_left_alone(suite, folder, rerun, finished):
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.name != ".lock"}
    for change, message in (
        ({"trials": 1}, r"holds 6 cells that this run does not have, .*trial 1"),
        ({"snr_db": [0]}, r"holds 6 cells that this run does not have, .*at 10 dB"),
        ({"estimators": ["good[n=2]", "dice"]}, "holds 4 cells that this run does not have.* wreck"),
        ({"estimators": ["good[n=3]", FAILING, "dice"]}, "4 cells that this run does not have.*good"),
        ({"seed": 7}, "it holds cells of seed 0, not 7"),
        ({"name": "other"}, "it holds cells of suite test, not other"),
    ):
        with pytest.raises(InputError, match=message):
            go(suite.model_copy(update=change), folder, *rerun)
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.name != ".lock"} == before


def test_rows_are_kept_unless_they_are_asked_for_and_an_interrupted_rerun_goes_on(
    suite, folder, undisturbed, finished
):
    assert go(suite, folder)[1] == 0
    assert table(folder) == undisturbed
    kill_after(suite, folder, 2, "failed")
    assert len(Run.open(folder).rows) == 12 - 4 + 2
    assert go(suite, folder)[1] == 2
    assert table(folder) == undisturbed
    # A part of a run drops no rows of the others.
    assert go(suite, folder, "all", shard="2/2")[1] == 6
    assert table(folder) == undisturbed


def test_rows_of_another_content_of_the_scenario_are_refused_or_made_again(
    suite, folder, tiny, undisturbed, finished
):
    # How it is written is no content.
    tiny.write_text("# A comment.\n" + tiny.read_text().replace("[5.0, 40.0, 10.0]", "[5, 4e1, 10]"))
    assert go(suite, folder)[1] == 0
    points = tiny.with_name("tiny.csv")
    points.write_text(points.read_text().replace("5,6,1,10,2", "5,6,1,10,3"))
    for options in ({}, {"mix_versions": True}):
        with pytest.raises(
            InputError, match="12 of its 12 cells were made with different content of scenario 'tiny'"
        ):
            go(suite, folder, **options)
    results, n_made = go(suite, folder, "stale")
    assert n_made == 12
    assert results.rows["scenario_content"].nunique() == 1
    assert table(folder) != undisturbed


def test_rows_of_other_versions_are_refused_or_stay_beside_new_ones_or_are_made_again(
    suite, folder, wreck, finished
):
    wreck.write_text(wreck.read_text() + "\n# Another version.\n")
    with isolated_plugins():
        discovery._files.clear()
        load_plugin_file(wreck)
        with pytest.raises(
            InputError, match=r"12 of its 12 cells were made by other versions.*wreck\.py digest"
        ):
            go(suite, folder)
        with pytest.raises(InputError, match="8 of its 12 cells were made by other versions"):
            go(suite, folder, "failed")
        results, n_made = go(suite, folder, "failed", mix_versions=True)
        assert n_made == 4
        assert len(set(results.rows["environment"])) == 2
        assert set(results.rows["environment"]) == set(results.environments)
        # Now both are there, and each run must say again that it may be so.
        with pytest.raises(InputError, match="8 of its 12 cells were made by other versions"):
            go(suite, folder)
        assert go(suite, folder, "stale")[1] == 8


def some(places, n, seed):
    """Some of many places."""
    return random.Random(seed).sample(list(places), min(n, len(places)))


FEW_OR_MANY = pytest.mark.parametrize("n_places", [1, pytest.param(40, marks=SLOW)])


def damage(path, how, place):
    content = bytearray(path.read_bytes())
    if how == "cut":
        del content[place:]
    else:
        content[place] ^= 1 << place % 8
    path.write_bytes(content)


def go_despite_damage(suite, folder):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        _, n_made = go(suite, folder)
    assert all(issubclass(warning.category, InputWarning) for warning in caught)
    return n_made, [str(warning.message) for warning in caught]


@FEW_OR_MANY
@pytest.mark.parametrize("how", ["cut", "flip"])
@pytest.mark.parametrize("name", ["results.parquet", "clouds.parquet"])
def test_a_damaged_table_is_told_and_what_it_held_made_again(
    suite, tmp_path, complete, undisturbed, name, how, n_places
):
    for place in some(range((complete / name).stat().st_size), n_places, name + how):
        folder = shutil.copytree(complete, tmp_path / f"{place}")
        damage(folder / name, how, place)
        n_made, told = go_despite_damage(suite, folder)
        assert table(folder) == undisturbed
        # A flip where nothing is read, such as in statistics, does no harm.
        assert told or (how == "flip" and n_made == 0)
        assert all(str(folder / name) in message for message in told)
        # Failures have no cloud to lose.
        assert n_made == (0 if not told else 12 if name == "results.parquet" else 8)


@FEW_OR_MANY
@pytest.mark.parametrize("how", ["cut", "flip"])
def test_a_damaged_journal_loses_the_damaged_lines_alone(suite, tmp_path, undisturbed, how, n_places):
    """Which lines those are, the tests of journals say byte for byte."""
    whole = tmp_path / "whole"
    kill_after(suite, whole, 6)
    journal = (whole / "journal.jsonl").read_bytes()
    heading = journal.index(b"\n") + 1
    for place in some(range(heading, len(journal)), n_places, how):
        folder = shutil.copytree(whole, tmp_path / f"{place}")
        damage(folder / "journal.jsonl", how, place)
        n_made, told = go_despite_damage(suite, folder)
        assert table(folder) == undisturbed
        if how == "flip":
            assert 6 <= n_made <= 8  # two lines, where the end of the first one is hit
            assert told or n_made == 6


@FEW_OR_MANY
@pytest.mark.parametrize("how", ["cut", "flip"])
@pytest.mark.parametrize("name", ["truth.parquet", "manifest.json", "results.csv"])
def test_damage_to_what_can_be_written_anew_costs_no_cell(
    suite, tmp_path, complete, undisturbed, name, how, n_places
):
    for place in some(range((complete / name).stat().st_size), n_places, name + how):
        folder = shutil.copytree(complete, tmp_path / f"{place}")
        damage(folder / name, how, place)
        if name == "manifest.json" and (version := other_metric_version(folder)):
            with pytest.raises(InputError, match=f"metric paper: version {version}, wanted: version 1; re"):
                go_despite_damage(suite, folder)
        else:
            assert go_despite_damage(suite, folder)[0] == 0
            assert table(folder) == undisturbed


def other_metric_version(folder):
    """Version of the metric in the manifest, if it can be read and is not the present one."""
    try:
        metric = json.loads((folder / "manifest.json").read_text())["scores"]["metrics"]["paper"]
        return None if metric["version"] == Paper.version else metric["version"]
    except (ValueError, KeyError):
        return None


@pytest.mark.parametrize(
    "names", [["results.parquet", "truth.parquet"], ["clouds.parquet", "manifest.json", "results.csv"]]
)
def test_missing_files_are_made_anew(suite, folder, undisturbed, names, finished):
    for name in names:
        (folder / name).unlink()
    go(suite, folder)
    assert table(folder) == undisturbed


def test_cells_are_not_kept_where_other_metrics_scored_them_or_it_is_not_known_which(suite, folder, finished):
    path, further = folder / "manifest.json", suite.replace(metrics=["repository"])
    with pytest.raises(InputError, match="repository: not at all"):
        go(further, folder, "all", shard="1/2")
    manifest = json.loads(path.read_text())
    manifest["scores"]["metrics"]["paper"]["version"] = 0
    path.write_text(json.dumps(manifest))
    with pytest.raises(InputError, match="metric paper: version 0, wanted: version 1; rescore it first"):
        go(suite, folder, mix_versions=True)
    path.unlink()
    with pytest.raises(InputError, match=r"manifest\.json is missing or damaged.*--rerun all"):
        go(further, folder)
    assert go(further, folder, "all")[1] == further.trials * 2 * 3


def test_a_report_on_a_torn_journal_says_what_it_leaves_out(suite, folder):
    kill_after(suite, folder, 5)
    journal = folder / "journal.jsonl"
    damage(journal, "cut", journal.stat().st_size - 20)
    with pytest.warns(
        InputWarning, match=r"journal\.jsonl: damaged, its cells are left out and run again \(1 li"
    ):
        results = Run.open(folder)
    assert len(results.rows) == 4
    assert set(results.rows["environment"]) == set(results.environments)


def test_rows_that_came_twice_are_damage(suite, folder, finished, undisturbed):
    records = pd.read_parquet(folder / "results.parquet")
    records.attrs = {}
    pd.concat([records, records]).to_parquet(folder / "results.parquet")
    with pytest.raises(InputError, match="damaged run"):
        Run.open(folder)
    n_made, told = go_despite_damage(suite, folder)
    assert n_made == 12
    assert len(told) == 1
    assert table(folder) == undisturbed


@pytest.mark.parametrize("n_jobs", [pytest.param(1, marks=SLOW), 2])
def test_processes_go_on_with_what_this_process_began_and_give_its_table(suite, folder, undisturbed, n_jobs):
    kill_after(suite, folder, 5)
    assert go(suite, folder, jobs=n_jobs)[1] == 7
    assert table(folder) == undisturbed


def test_parts_of_a_run_make_its_cells_once(suite, folder, undisturbed):
    made = [go(suite, folder, shard=f"{k}/2")[1] for k in (1, 2, 2)]
    assert made == [6, 6, 0]
    assert table(folder) == undisturbed


def test_a_full_disk_ends_the_run_with_one_message_and_keeps_the_rows(
    suite, folder, undisturbed, monkeypatch
):
    make = Journal.__init__

    def make_full(journal, path, columns):
        make(journal, path, columns)
        file, room = journal._file, 4000

        def write(content):
            """Take so many bytes, of the last line a part, and then none."""
            nonlocal room
            if not room:
                raise OSError(28, "No space left on device")
            part = bytes(content)[:room]
            room -= len(part)
            return file.write(part)

        journal._file = Mock(write=write, close=file.close)

    with monkeypatch.context() as patch:
        patch.setattr(Journal, "__init__", make_full)
        with pytest.raises(InputError, match=r"journal\.jsonl: cannot be written: No space left"):
            go(suite, folder)
    n_made, told = go_despite_damage(suite, folder)
    assert 0 < n_made < 12
    assert len(told) == 1
    assert table(folder) == undisturbed


@pytest.mark.parametrize(
    ("raised", "expected", "message"),
    [
        (OSError(28, "No space left"), InputError, r"results\.csv: cannot be written: No space left"),
        (KeyboardInterrupt, KeyboardInterrupt, None),
    ],
)
def test_a_table_that_cannot_be_written_leaves_the_journal(
    suite, folder, undisturbed, monkeypatch, raised, expected, message
):
    with monkeypatch.context() as patch:
        patch.setattr("isacbench.bench.store.run_folder.write_csv_table", Mock(side_effect=raised))
        with pytest.raises(expected, match=message):
            go(suite, folder)
    assert go(suite, folder)[1] == 0
    assert table(folder) == undisturbed


def test_rows_to_be_made_again_stay_until_there_is_somebody_to_make_them(
    suite, folder, finished, undisturbed, monkeypatch
):
    monkeypatch.setattr("isacbench.bench.cells.cluster.WAIT_S", 0.2)
    nowhere = RunOptions(dask="tcp://127.0.0.1:1", rerun=("all",))
    with pytest.raises(InputError, match="dask"):
        run_suite(suite, folder, options=nowhere)
    assert table(folder) == undisturbed
