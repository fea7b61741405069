"""Run times that count: what is measured, in which rows, and what becomes of those of other runs."""

import gc
import json
from functools import partial

import numpy as np
import pandas as pd
import pytest

from isacbench.bench.cells.cell import repeat
from isacbench.bench.cells.rows import REFERENCE_COLUMNS, TIMES, TIMING_COLUMNS
from isacbench.bench.compare.comparison import compare_tables, parse_tolerance
from isacbench.bench.kinds.detection import DetectionSuite
from isacbench.bench.kinds.resolution import ResolutionSuite
from isacbench.bench.run.merging import merge
from isacbench.bench.run.rescoring import rescore
from isacbench.bench.run.runner import RunOptions, run, run_suite
from isacbench.bench.store.manifest import read_manifest
from isacbench.bench.store.run import Run
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputError
from isacbench.instrument.stages import STAGES, StageClock, stage
from isacbench.plugins.discovery import load_plugin_file

STAGE_COLUMNS = [f"time_{name}_s" for name in STAGES]
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
def suite(suite):
    return suite.replace(snr_db=[0])


@pytest.fixture
def moody_suite(moody, tiny):
    return Suite(name="test", scenarios=[str(tiny)], estimators=["moody"], snr_db=[0], trials=1)


timed_run = partial(run, timing=True, repeats=2)


@pytest.fixture
def ordinary(suite, run_once):
    """Return a folder with a run that was not timed."""
    return run_once("ordinary", suite)


@pytest.fixture(autouse=True, scope="module")
def quick_collections():
    """Take what other tests have left behind out of the collector's sight: it is called for every cell."""
    gc.freeze()
    yield
    gc.unfreeze()


@pytest.fixture
def hand(clock, monkeypatch):
    monkeypatch.setattr("isacbench.bench.cells.cell.StageClock", partial(StageClock, clock))
    return clock


def test_the_time_is_the_median_of_repeats_and_the_spread_half_of_the_quartiles_distance(hand):
    durations = iter([9.0, 1.0, 2.0, 4.0, 3.0, 100.0])

    def call(duration):
        hand.time_s += duration

    results, columns = repeat(lambda: next(durations), call, 5)
    assert columns["time_estimate_s"] == 3
    assert columns["time_spread_s"] == (4 - 2) / 2
    assert len(results) == 6
    assert np.isnan(repeat(lambda: None, lambda _: None, 1)[1]["time_spread_s"])


def test_each_stage_has_the_median_of_its_exclusive_times_and_0_where_it_does_not_occur(hand):
    durations = iter([1.0, 3.0, 2.0, 0.0])

    def call(duration):
        with stage("peaks"):
            hand.time_s += duration
            with stage("spectrum"):
                hand.time_s += 10 * duration

    _, columns = repeat(lambda: next(durations), call, 3)
    expected = dict.fromkeys(STAGE_COLUMNS, 0) | {"time_peaks_s": 2, "time_spectrum_s": 20}
    assert {name: columns[name] for name in STAGE_COLUMNS} == expected
    assert columns.keys() == {"time_estimate_s", *TIMING_COLUMNS}


def test_what_a_trial_needs_is_made_before_each_repeat_and_not_timed(hand):
    made = iter(range(10))

    def prepare():
        hand.time_s += 50
        return next(made)

    results, columns = repeat(prepare, lambda number: number, 3)
    assert results == [0, 1, 2, 3]
    assert columns["time_estimate_s"] == 0


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
    repeat(lambda: None, lambda _: seen.append((gc.isenabled(), Knot.freed)), 2)
    assert seen == [(False, 1)] * 3
    assert gc.isenabled()


def test_the_collector_works_again_after_a_failure_and_stays_off_where_it_was_off():
    with pytest.raises(ZeroDivisionError):
        repeat(lambda: None, lambda _: 1 / 0, 2)
    assert gc.isenabled()
    gc.disable()
    try:
        repeat(lambda: None, lambda _: None, 1)
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_the_peak_memory_is_what_is_allocated_at_once_beyond_what_was_there():
    held = [np.ones(2**20)]

    def call(_):
        first = np.ones(3 * 2**17)  # 3 MiB
        del first
        return np.ones(2**17).sum() + held[0][0]

    assert 3 <= repeat(lambda: None, call, 2)[1]["peak_memory_mib"] < 3.1


def test_rows_of_a_timed_run_say_so_and_have_stages_and_memory_beside_the_same_scores(moody_suite):
    ordinary = run(moody_suite)
    assert not ordinary["timing"].any()
    columns = ordinary.columns.drop([*TIMES, "timing"])
    for jobs in (None, 1):
        records = timed_run(moody_suite, jobs=jobs)
        assert records["timing"].all()
        assert records.columns.tolist() == [*ordinary.columns, *TIMING_COLUMNS]
        pd.testing.assert_frame_equal(records[columns], ordinary[columns])
        (row,) = records.to_dict("records")
        assert row["status"] == "ok"
        assert 0 < row["time_detection_s"] + row["time_peaks_s"] <= 2 * row["time_estimate_s"]
        assert row["time_rdm_s"] == row["time_refinement_s"] == 0
        assert row["peak_memory_mib"] > 0


def test_references_are_timed_like_others_and_each_repeat_has_a_fresh_observation(moody_suite):
    # Every repeat of the reader is of an observation that nobody has read.
    records = run(moody_suite, estimators=["oracle", "reader"], timing=True, repeats=1)
    assert records["status"].tolist() == ["ok", "ok"]
    assert records["timing"].all()
    assert records.columns.tolist()[-len(REFERENCE_COLUMNS) :] == list(REFERENCE_COLUMNS)
    assert set(TIMING_COLUMNS) <= set(records)


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


def test_a_cell_whose_repeats_differ_or_fail_has_failed(moody_suite):
    records = timed_run(moody_suite, estimators=["moody[kind=[drift,fail]]"])
    assert records["status"].tolist() == ["error", "error"]
    reasons = ("1 of 3 repeats of the same estimate gave another result; only", "ZeroDivisionError: no luck")
    for reason, told in zip(reasons, records["reason"], strict=True):
        assert told.startswith(reason)
    assert records["timing"].all()
    assert set(records["n_estimated"]) == {0}
    assert records[["deviation", *TIMING_COLUMNS]].isna().all(axis=None)


def test_a_plugin_that_draws_from_the_shared_generators_repeats_itself(wreck, tiny):
    suite = Suite(name="test", scenarios=[str(tiny)], estimators=["dice"], snr_db=[0], trials=2)
    timed, ordinary = timed_run(suite), run(suite)
    assert set(timed["status"]) == {"ok"}
    assert timed["deviation"].equals(ordinary["deviation"])


def test_the_first_estimate_has_the_deadline_and_the_repeats_have_one_each(moody_suite):
    troubles = {
        "hang,at=0": ("timeout", "more than 1 s"),
        "hang,at=1": ("timeout", "more than 3 s, in 3 repeats"),
        "leave,at=1": ("killed", "the process exited with code 7, in 3 repeats"),
    }
    estimators = [f"moody[kind={trouble}]" for trouble in troubles] + ["moody[kind=steady]"]
    records = timed_run(moody_suite, estimators=estimators, jobs=1, timeout_s=1)
    assert [*zip(records["status"], records["reason"], strict=True)] == [*troubles.values(), ("ok", "")]
    assert records["timing"].all()


def test_the_worker_is_idle_while_its_answers_are_taken(moody_suite, tmp_path):
    log = tmp_path / "log"
    suite = moody_suite.replace(estimators=[f"moody[log={log}]"], snr_db=[0, 5], trials=2)
    seen = []

    def progress(n_done, n_cells):
        seen.append((n_done, len(log.read_text())))

    run_suite(suite, progress=progress, options=RunOptions(jobs=1, timing=True, repeats=3))
    assert seen == [(n, 5 * n) for n in (1, 2, 3, 4)]  # the first estimate, three timed, one for its memory


def n_made(suite, folder, **options):
    """Run into a folder and return the records and the number of cells that were made."""
    calls = []
    chosen = RunOptions(**options)
    results = run_suite(suite, folder, lambda *done: calls.append(done), chosen)
    return results.rows, len(calls)


def test_rows_that_were_not_timed_are_made_again_by_a_timed_run_whose_session_says_so(suite, ordinary):
    # A shard makes only its own rows again.
    records, n = n_made(suite, ordinary, timing=True, repeats=2, shard="1/3")
    assert (records["timing"] == (records["trial"] == 0)).all()
    assert n == 2
    records, n = n_made(suite, ordinary, timing=True, repeats=2)
    assert (n, len(records)) == (4, 6)
    assert records["timing"].all()
    assert records[STAGE_COLUMNS].notna().all(axis=None)
    sessions = read_manifest(ordinary)["sessions"]
    assert [(one["timing"], one["repeats"]) for one in sessions] == [(False, None), (True, 2), (True, 2)]
    text = (ordinary / "manifest.json").read_text()
    json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert n_made(suite, ordinary, timing=True, repeats=3)[1] == 0


def test_timed_rows_are_kept_by_a_run_that_is_not_timed_and_by_scoring_again(suite, tmp_path):
    timed = tmp_path / "timed"
    timed_run(suite, out=timed)
    before = Run.open(timed).rows
    assert rescore(timed).n_changed == 0
    pd.testing.assert_frame_equal(Run.open(timed).rows, before)
    records, n = n_made(suite.replace(trials=4), timed)
    assert n == len(records) - len(before)
    assert (records["timing"] == (records["trial"] < 3)).all()
    assert (records[STAGE_COLUMNS].notna().all(axis=1) == records["timing"]).all()
    pd.testing.assert_frame_equal(pd.read_parquet(timed / "results.parquet"), records)


def test_a_timed_shard_is_merged_with_its_times_which_stay_where_another_part_has_not_timed(
    suite, ordinary, tmp_path
):
    shard = tmp_path / "shard"
    part = timed_run(suite, out=shard, shard="1/2")
    for n, folders in enumerate(([shard, ordinary], [ordinary, shard])):
        mixed = merge(folders, tmp_path / f"mixed{n}").run.rows
        assert len(mixed) == 6
        assert (mixed["timing"] == mixed["trial"].isin(part["trial"])).all()
        of_shard = mixed.loc[mixed["timing"], ["time_estimate_s", *STAGE_COLUMNS]]
        assert of_shard.to_numpy().tolist() == part[of_shard.columns].to_numpy().tolist()


def test_the_times_of_two_timed_runs_are_compared_stage_by_stage(moody_suite, tmp_path):
    timed_run(moody_suite, trials=10, out=tmp_path / "run")
    base = Run.open(tmp_path / "run").require_finished()
    twice, untimed = base.changed(rows=base.rows.copy()), base.rows.drop(columns="time_detection_s")
    names = ["time_estimate_s", "time_detection_s"]
    asked = [parse_tolerance(f"{name}=10%") for name in names]
    same = compare_tables(base, base, asked)
    times = same.curves.set_index("metric").loc[names]
    assert times["n_pairs"].tolist() == [10, 10]
    assert (times["change"] == 0).all()
    assert not same.notes
    assert same.n_lost_scores == 0
    twice.rows[names] *= 2
    slower = compare_tables(base, twice, asked)
    assert slower.curves.set_index("metric")["verdict"][names].tolist() == ["regression"] * 2
    assert slower.is_regression
    with pytest.raises(InputError, match="no better direction"):
        compare_tables(base, base, [parse_tolerance("time_spread_s=10%")])
    with pytest.raises(InputError, match="unknown score 'time_detection_s'"):
        compare_tables(base, base.changed(rows=untimed), asked)
