"""Run times that count: what is measured, in which rows, and what becomes of those of other runs."""

import gc
import json
from functools import partial

import numpy as np
import pandas as pd
import pytest

from isacbench.bench.cells.record import TIMES, TIMING_COLUMNS
from isacbench.bench.cells.timing import Trial, repeat
from isacbench.bench.compare.comparison import compare_tables
from isacbench.bench.compare.matching import read_run
from isacbench.bench.compare.tolerance import parse_tolerance
from isacbench.bench.run.merging import merge
from isacbench.bench.run.rescoring import rescore
from isacbench.bench.run.runner import Execution, run
from isacbench.bench.store.run_store import read_manifest, read_results
from isacbench.bench.suites.detection_kind import DetectionSuite
from isacbench.bench.suites.resolution_kind import ResolutionSuite
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputError
from isacbench.instrument.stages import STAGES, StageClock, stage
from isacbench.plugins.discovery import load_plugin_file

STAGE_COLUMNS = [f"time_{name}_s" for name in STAGES]
ALL_TIMES = [*TIMES, *TIMING_COLUMNS]

MOODY = '''
"""Plugins whose later calls differ from the first one."""

import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from isacbench.plugins.contracts import Detection
from isacbench.model.cloud import PointCloud
from isacbench.instrument.stages import stage

CALLS = {}


def n_before(key):
    """Calls so far in this process."""
    CALLS[key] = CALLS.get(key, 0) + 1
    return CALLS[key] - 1


def point(observation, x=0.0):
    return PointCloud([observation.region.lower_m + [x, 0, 0]], [0.0], [1.0])


@dataclass(frozen=True)
class Moody:
    """Changes its mood at a call, counted from 0."""

    name: ClassVar[str] = "moody"
    kind: str = "steady"
    at: int = 2
    log: str = ""

    def estimate(self, observation):
        if self.log:
            with Path(self.log).open("a") as file:
                file.write("x")
        with stage("detection"):
            changed = n_before((self.kind, float(np.abs(observation.cells).sum()))) == self.at
        with stage("subspace"), stage("peaks"):
            return getattr(self, self.kind)(observation) if changed else point(observation)

    def steady(self, observation):
        return point(observation)

    def drift(self, observation):
        return point(observation, 1e-12)

    def fail(self, observation):
        raise ZeroDivisionError("no luck")

    def hang(self, observation):
        time.sleep(600)

    def leave(self, observation):
        os._exit(7)


@dataclass(frozen=True)
class Reader:
    """Tells by its cloud whether somebody has read the same observation before."""

    name: ClassVar[str] = "reader"

    def estimate(self, observation):
        was_read = "cosine_limits" in vars(observation)
        observation.cosine_limits
        return point(observation, float(was_read))


@dataclass(frozen=True)
class Whim:
    """Detects other cells at every call."""

    name: ClassVar[str] = "whim"
    pfa: float = 1e-3

    def detect(self, power, looks=1):
        mask = np.zeros(power.shape, dtype=bool)
        mask.ravel()[n_before("whim")] = True
        return Detection(mask, power, power)
'''


@pytest.fixture
def moody(write_plugin):
    load_plugin_file(write_plugin("moody.py", MOODY))


@pytest.fixture
def suite(plugins, tiny):
    return Suite(
        name="test", scenarios=[str(tiny)], estimators=["blob", "seer"], snr_db=[-10, 0], trials=3, seed=1
    )


@pytest.fixture
def moody_suite(moody, tiny):
    return Suite(name="test", scenarios=[str(tiny)], estimators=["moody"], snr_db=[0], trials=1)


timed_run = partial(run, timing=True, repeats=2)


@pytest.fixture(autouse=True, scope="module")
def quick_collections():
    """Take what other tests have left behind out of the collector's sight: it is called for every cell."""
    gc.freeze()
    yield
    gc.unfreeze()


class Hand:
    """A clock whose time passes when a test says so."""

    time_s = 0.0

    def __call__(self):
        return self.time_s


@pytest.fixture
def hand(monkeypatch):
    hand = Hand()
    monkeypatch.setattr("isacbench.bench.cells.timing.StageClock", partial(StageClock, hand))
    return hand


def test_the_time_is_the_median_of_repeats_and_the_spread_half_of_the_quartiles_distance(hand):
    durations = iter([9.0, 1.0, 2.0, 4.0, 3.0, 100.0])

    def call(duration):
        hand.time_s += duration

    found = repeat(Trial(lambda: next(durations), call), 5)
    assert found.time_s == 3
    assert found.columns["time_spread_s"] == (4 - 2) / 2
    assert len(found.results) == 6


def test_each_stage_has_the_median_of_its_exclusive_times_and_0_where_it_does_not_occur(hand):
    durations = iter([1.0, 3.0, 2.0, 0.0])

    def call(duration):
        with stage("peaks"):
            hand.time_s += duration
            with stage("spectrum"):
                hand.time_s += 10 * duration

    found = repeat(Trial(lambda: next(durations), call), 3)
    expected = dict.fromkeys(STAGE_COLUMNS, 0) | {"time_peaks_s": 2, "time_spectrum_s": 20}
    assert {name: found.columns[name] for name in STAGE_COLUMNS} == expected
    assert found.columns.keys() == TIMING_COLUMNS.keys()


def test_what_a_trial_needs_is_made_before_each_repeat_and_not_timed(hand):
    made = iter(range(10))

    def prepare():
        hand.time_s += 50
        return next(made)

    found = repeat(Trial(prepare, lambda number: number), 3)
    assert found.results == [0, 1, 2, 3]
    assert found.time_s == 0


def test_one_repeat_has_no_spread():
    assert np.isnan(repeat(Trial(lambda: None, lambda _: None), 1).columns["time_spread_s"])


def test_garbage_is_collected_before_and_not_while_it_is_timed():
    class Knot:
        """Something that only the collector frees."""

        freed = 0

        def __init__(self):
            self.itself = self

        def __del__(self):
            Knot.freed += 1

    Knot()
    seen = []
    repeat(Trial(lambda: None, lambda _: seen.append((gc.isenabled(), Knot.freed))), 2)
    assert seen == [(False, 1)] * 3
    assert gc.isenabled()


def test_the_collector_works_again_after_a_failure_and_stays_off_where_it_was_off():
    with pytest.raises(ZeroDivisionError):
        repeat(Trial(lambda: None, lambda _: 1 / 0), 2)
    assert gc.isenabled()
    gc.disable()
    try:
        repeat(Trial(lambda: None, lambda _: None), 1)
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_the_peak_memory_is_what_is_allocated_at_once_beyond_what_was_there():
    held = [np.ones(2**20)]

    def call(_):
        first = np.ones(3 * 2**17)  # 3 MiB
        del first
        return np.ones(2**17).sum() + held[0][0]

    assert 3 <= repeat(Trial(lambda: None, call), 2).columns["peak_memory_mib"] < 3.1


@pytest.mark.parametrize("jobs", [None, 1])
def test_rows_of_a_timed_run_say_so_and_have_stages_and_memory_beside_the_same_scores(
    moody_suite, tiny, jobs
):
    records, ordinary = timed_run(moody_suite, jobs=jobs), run(moody_suite)
    assert records["timing"].all()
    assert not ordinary["timing"].any()
    assert records.columns.tolist() == [*ordinary.columns, *TIMING_COLUMNS]
    columns = ordinary.columns.drop([*TIMES, "timing"])
    pd.testing.assert_frame_equal(records[columns], ordinary[columns])
    (row,) = records.to_dict("records")
    assert row["status"] == "ok"
    assert 0 < row["time_detection_s"] + row["time_peaks_s"] <= 2 * row["time_estimate_s"]
    assert row["time_rdm_s"] == row["time_refinement_s"] == 0
    assert row["peak_memory_mib"] > 0


def test_every_kind_of_suite_can_be_timed(moody, plugins, tiny, room_file):
    rooms = {"name": "test", "scenarios": [str(room_file)], "estimators": ["blob"], "trials": 1}
    for suite in (
        Suite(kind="efficiency", snr_gain_db=[20], **rooms),
        ResolutionSuite(snr_gain_db=[20], dimensions=["u"], separations_cells=[1], **rooms),
        DetectionSuite(
            name="test",
            scenarios=[str(tiny)],
            estimators=["blob"],
            detectors=["level", "whim"],
            maps=["homogeneous"],
            snr_db=[-10],
            trials=1,
        ),
    ):
        records = timed_run(suite)
        assert records["timing"].all()
        of_maps = records["estimator"].isin(["level", "whim"])
        assert (records.loc[~of_maps, "status"] == "ok").all()
        assert records.loc[~of_maps, STAGE_COLUMNS].notna().all(axis=None)
    level, whim = (records[records["estimator"] == name].iloc[0] for name in ("level", "whim"))
    assert 0 < level["time_detection_s"] <= level["time_estimate_s"]
    assert (whim["status"], whim["timing"]) == ("error", True)


@pytest.mark.parametrize("jobs", [None, 1])
@pytest.mark.parametrize(
    ("kind", "status", "reason"),
    [
        ("drift", "error", "1 of 3 repeats of the same estimate gave another result; only"),
        ("fail", "error", "ZeroDivisionError: no luck"),
    ],
)
def test_a_cell_whose_repeats_differ_has_failed(moody_suite, kind, status, reason, jobs):
    (row,) = timed_run(moody_suite, estimators=[f"moody[kind={kind}]"], jobs=jobs).to_dict("records")
    assert (row["status"], row["timing"]) == (status, True)
    assert row["reason"].startswith(reason)
    assert row["n_estimated"] == 0
    assert np.isnan([row[name] for name in ("deviation", *TIMING_COLUMNS)]).all()


def test_a_plugin_that_draws_from_the_shared_generators_repeats_itself(wreck, tiny):
    suite = Suite(name="test", scenarios=[str(tiny)], estimators=["dice"], snr_db=[0], trials=2)
    timed, ordinary = timed_run(suite), run(suite)
    assert set(timed["status"]) == {"ok"}
    assert timed["deviation"].equals(ordinary["deviation"])


def test_every_repeat_meets_an_observation_that_nobody_has_read(moody_suite):
    assert set(timed_run(moody_suite, estimators=["reader"])["status"]) == {"ok"}


@pytest.mark.parametrize(
    ("kind", "at", "status", "reason"),
    [
        ("hang", 0, "timeout", "more than 0.5 s"),
        ("hang", 1, "timeout", "more than 1.5 s, in 3 repeats"),
        ("leave", 1, "killed", "the process exited with code 7, in 3 repeats"),
    ],
)
def test_the_first_estimate_has_the_deadline_and_the_repeats_have_one_each(
    moody_suite, kind, at, status, reason
):
    estimators = [f"moody[kind={kind},at={at}]", "moody[kind=steady]"]
    records = timed_run(moody_suite, estimators=estimators, jobs=1, timeout_s=0.5)
    assert records["status"].tolist() == [status, "ok"]
    assert records["reason"].tolist() == [reason, ""]
    assert records["timing"].all()


def test_the_worker_is_idle_while_its_answers_are_taken(moody_suite, tmp_path):
    from isacbench.bench.run.runner import run_suite

    log = tmp_path / "log"
    suite = moody_suite.replace(estimators=[f"moody[log={log}]"], snr_db=[0, 5], trials=2)
    seen = []

    def progress(n_done, n_cells):
        seen.append((n_done, len(log.read_text())))

    run_suite(suite, progress=progress, execution=Execution(n_jobs=1, repeats=3))
    assert seen == [(n, 5 * n) for n in (1, 2, 3, 4)]  # the first estimate, three timed, one for its memory


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"timing": True, "jobs": 2}, "timing needs one job on this machine, not jobs 2"),
        ({"timing": True, "dask": "tcp://nowhere:1"}, "timing needs one job on this machine, not dask"),
        ({"timing": True, "repeats": 0}, "repeats 0: allowed is 1 or more"),
        ({"repeats": 3}, "repeats = 3 needs timing"),
    ],
)
def test_what_cannot_be_timed_is_refused(suite, options, message):
    with pytest.raises(InputError, match=message):
        run(suite, **options)


def test_sessions_say_whether_they_were_timed_and_how_often_they_repeated(suite, tmp_path):
    run(suite, trials=1, out=tmp_path / "run")
    timed_run(suite, trials=1, out=tmp_path / "run")
    sessions = read_manifest(tmp_path / "run")["sessions"]
    assert [(one["timing"], one["repeats"]) for one in sessions] == [(False, None), (True, 2)]


def n_made(suite, folder, **options):
    """Run into a folder and return the records and the number of cells that were made."""
    from isacbench.bench.run.runner import run_suite

    calls = []
    execution = Execution(**options)
    results = run_suite(suite, folder, lambda *done: calls.append(done), execution)
    return results.records, len(calls)


def test_rows_that_were_not_timed_are_made_again_by_a_timed_run(suite, tmp_path):
    ordinary, _ = n_made(suite, tmp_path / "run")
    records, n = n_made(suite, tmp_path / "run", repeats=2)
    assert n == len(records) == len(ordinary)
    assert records["timing"].all()
    assert records[STAGE_COLUMNS].notna().all(axis=None)
    assert n_made(suite, tmp_path / "run", repeats=3)[1] == 0


def test_timed_rows_are_kept_by_a_run_that_is_not_timed(suite, tmp_path):
    timed, _ = n_made(suite, tmp_path / "run", repeats=2)
    records, n = n_made(suite.replace(trials=4), tmp_path / "run")
    assert n == len(records) - len(timed)
    assert (records["timing"] == (records["trial"] < 3)).all()
    assert (records[STAGE_COLUMNS].notna().all(axis=1) == records["timing"]).all()
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "run" / "results.parquet"), records)


def test_a_timed_run_that_was_interrupted_goes_on(suite, tmp_path):
    from isacbench.bench.run.runner import run_suite

    def progress(n_done, n_cells):
        if n_done == 5:
            raise KeyboardInterrupt

    first = run_suite(suite, tmp_path / "run", progress, Execution(n_jobs=1, repeats=2))
    assert (first.interrupted, len(first.records)) == (True, 5)
    records, n = n_made(suite, tmp_path / "run", repeats=2)
    assert n == len(records) - 5
    assert records["timing"].all()
    assert records[ALL_TIMES].notna().all(axis=None)
    whole = run(suite)
    columns = whole.columns.drop([*TIMES, "timing"])
    pd.testing.assert_frame_equal(records[columns], whole[columns])


def test_a_timed_shard_makes_only_its_own_rows_again(suite, tmp_path):
    n_made(suite, tmp_path / "run")
    records = timed_run(suite, out=tmp_path / "run", shard="1/3")
    assert (records["timing"] == (records["trial"] == 0)).all()


def test_timed_shards_are_merged_with_their_times(suite, tmp_path):
    shards = [tmp_path / f"shard{k}" for k in (1, 2)]
    parts = [timed_run(suite, out=folder, shard=f"{folder.name[-1]}/2") for folder in shards]
    merged = merge(shards, tmp_path / "merged").records
    assert merged["timing"].all()
    assert sorted(merged["time_estimate_s"]) == sorted(pd.concat(parts)["time_estimate_s"])
    assert merged[STAGE_COLUMNS].notna().all(axis=None)


@pytest.mark.parametrize("order", [("timed", "ordinary"), ("ordinary", "timed")])
def test_of_a_cell_that_one_part_has_timed_and_another_has_not_the_timed_row_stays(suite, tmp_path, order):
    run(suite, out=tmp_path / "ordinary")
    timed = timed_run(suite, out=tmp_path / "timed", shard="1/3")
    merged = merge([tmp_path / name for name in order], tmp_path / "merged").records
    assert (merged["timing"] == (merged["trial"] == 0)).all()
    assert merged.loc[merged["timing"], "time_estimate_s"].tolist() == timed["time_estimate_s"].tolist()
    assert len(merged) == 12


def test_scoring_again_leaves_the_times_as_they_are(suite, tmp_path):
    records = timed_run(suite, out=tmp_path / "run")
    assert rescore(tmp_path / "run").n_changed == 0
    pd.testing.assert_frame_equal(read_results(tmp_path / "run").records, records)


TIME = [parse_tolerance("time_estimate_s=10%"), parse_tolerance("time_detection_s=10%")]


@pytest.fixture(scope="module")
def shelf(tmp_path_factory):
    """Return a folder for runs that several tests read."""
    return tmp_path_factory.mktemp("runs")


@pytest.fixture
def two_timed_runs(moody_suite, shelf):
    folders = shelf / "base", shelf / "new"
    for folder in folders:
        if not folder.exists():
            timed_run(moody_suite, out=folder, trials=12)
    return folders


def test_the_times_of_two_timed_runs_are_compared(two_timed_runs):
    found = compare_tables(*map(read_run, two_timed_runs), TIME)
    times = found.curves.set_index("metric").loc[["time_estimate_s", "time_detection_s"]]
    assert times["n_pairs"].tolist() == [12, 12]
    assert times["change"].notna().all()
    assert not found.notes
    assert found.n_lost_scores == 0


def test_a_stage_that_takes_twice_as_long_is_a_regression(two_timed_runs):
    base, new = map(read_run, two_timed_runs)
    for name in ("time_estimate_s", "time_detection_s"):
        new.records[name] = 2 * base.records[name]
    found = compare_tables(base, new, TIME)
    verdicts = found.curves.set_index("metric")["verdict"]
    assert verdicts[["time_estimate_s", "time_detection_s"]].tolist() == ["regression"] * 2
    assert found.is_regression


def test_times_of_a_run_that_was_not_timed_are_not_compared(two_timed_runs, moody_suite, tmp_path):
    run(moody_suite, out=tmp_path / "ordinary", trials=12)
    found = compare_tables(read_run(two_timed_runs[0]), read_run(tmp_path / "ordinary"), TIME[:1])
    assert "time_estimate_s: 0 of 12 paired cells compared; 12 were not timed" in found.notes[0]
    with pytest.raises(InputError, match="unknown score 'time_detection_s'"):
        compare_tables(read_run(two_timed_runs[0]), read_run(tmp_path / "ordinary"), TIME)


def test_a_spread_is_neither_better_nor_worse(two_timed_runs):
    with pytest.raises(InputError, match="no better direction"):
        compare_tables(*map(read_run, two_timed_runs), [parse_tolerance("time_spread_s=10%")])


def test_the_manifest_of_a_timed_run_is_json(suite, tmp_path):
    timed_run(suite, trials=1, out=tmp_path / "run")
    text = (tmp_path / "run" / "manifest.json").read_text()
    json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
