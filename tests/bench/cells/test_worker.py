"""Whatever a plugin does costs its own cells a row, and nobody else anything."""

import gc
import os
import time
import warnings
from collections import deque
from concurrent.futures import CancelledError
from multiprocessing import active_children
from pathlib import Path
from queue import SimpleQueue
from threading import Lock, Thread

import pandas as pd
import pytest

from isacbench.bench.cells import worker as worker_module
from isacbench.bench.cells.cell import Limits
from isacbench.bench.cells.plan import Block, load_job
from isacbench.bench.cells.rows import TIMES
from isacbench.bench.cells.worker import Worker, rows_guarded
from isacbench.bench.run.runner import RunOptions, run_suite
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputError, InputWarning
from isacbench.plugins.discovery import load_plugin_file

SLOW = pytest.mark.slow

MEMORY_MIB = 256

FAILURES = {
    "raise_": ("error", "ZeroDivisionError: no luck"),
    "own": ("error", "OwnError: own"),
    "mute": ("error", "MuteError: its message raised ValueError"),
    "base": ("error", "Base: no Exception"),
    "surrogate": ("error", r"OSError: caf\udce9 two lines"),
    "long": ("error", f"ValueError: {'x' * 1000}..."),
    "recursion": ("error", "RecursionError: maximum recursion depth exceeded"),
    "interrupt": ("error", "KeyboardInterrupt"),
    "interrupt_and_change": ("error", "KeyboardInterrupt"),
    "leave": ("error", "SystemExit: 7"),
    "exit0": ("killed", "the process exited with code 0"),
    "exit7": ("killed", "the process exited with code 7"),
    "kill": ("killed", "the process died by SIGKILL"),
    "segfault": ("killed", "the process died by SIGSEGV"),
    "not_finite": ("error", "ValueError: a point cloud takes finite values; xyz has NaN or infinity"),
    "smuggle_nan": ("error", "ValueError: a point cloud takes finite values; xyz has NaN or infinity"),
    "smuggle_shape": ("error", "ValueError: a point cloud takes xyz (n, 3)"),
    "replace_nan": ("error", "ValueError: a point cloud takes finite values; power has NaN or infinity"),
    "number": ("error", "TypeError: estimate() must return a PointCloud, not int"),
    "nothing": ("error", "TypeError: estimate() must return a PointCloud, not NoneType"),
    "hog_small": ("killed", f"more than {MEMORY_MIB} MiB: "),
    "hog_large": ("killed", f"more than {MEMORY_MIB} MiB: "),
    "close_all": ("killed", "the process exited with code "),
    "half": ("killed", "the process exited with code 5"),
    "unlock": ("error", "ValueError: it changed the observation"),
    "by_address": ("error", "ValueError: it changed the observation"),
    "move_station": ("error", "ValueError: it changed the observation"),
    "swap_cells": ("error", "ValueError: it changed the observation"),
    "mirror": ("error", "ValueError: it changed the observation"),
    "ask": ("error", "EOFError: EOF when reading a line"),
}
"""What goes wrong, and the row that it becomes."""

STRANGE = ["child", "twins", "disturb", "thread", "flood"]
"""What no one should do, but that delivers an image."""

MORE_OF_THE_SAME = {
    "exit0",
    "exit7",
    "segfault",
    "hog_large",
    "smuggle_shape",
    "by_address",
    "swap_cells",
    "move_station",
}
"""Left to the slow tests, for each costs a fresh process or a fresh observation."""

DEADLY = {name for name, (status, _) in FAILURES.items() if status == "killed"}
HARMLESS_UNGUARDED = [*(set(FAILURES) - DEADLY - {"interrupt", "interrupt_and_change", "ask"}), "disturb"]

UNHURT = ["good", "dice"]


@pytest.fixture
def suite(wreck, tiny):
    """Return a function that makes a suite in which others meet the observation after every wreck."""

    def make(kinds, **changes):
        estimators = ["good[n=1]", "dice[n=1]"]
        for n, kind in enumerate(kinds, start=2):
            estimators += [f"wreck[kind={kind}]", f"good[n={n}]", f"dice[n={n}]"]
        settings = {"name": "test", "scenarios": [str(tiny)], "snr_db": [0], "trials": 1, **changes}
        return Suite(estimators=estimators, **settings)

    return make


def guarded(suite, n_jobs=1, **limits):
    limits = {"timeout_s": 60, "memory_mib": MEMORY_MIB, **limits}
    return run_suite(suite, options=RunOptions(jobs=n_jobs, **limits))


def others(records):
    """Rows of those that do no wrong, without times."""
    chosen = records[records["estimator"].isin(UNHURT)]
    return chosen.drop(columns=TIMES).reset_index(drop=True)


def of_kind(records, kind):
    return records[records["params"].str.contains(f'"kind":"{kind}"', regex=False)]


def assert_others_are_those_of_a_run_without(suite, records):
    alone = suite.replace(estimators=[text for text in suite.estimators if "wreck" not in text])
    pd.testing.assert_frame_equal(others(records), others(run_suite(alone).rows))


def assert_failures(records, kinds):
    for kind in kinds:
        (status, reason), rows = FAILURES[kind], of_kind(records, kind)
        assert set(rows["status"]) == {status}, (kind, rows["reason"].tolist())
        assert rows["reason"].str.startswith(reason).all(), (kind, rows["reason"].tolist())
        assert rows["deviation"].isna().all()
        assert (rows["time_estimate_s"] >= 0).all()


@pytest.mark.parametrize(
    "kinds",
    [
        [kind for kind in FAILURES if kind not in MORE_OF_THE_SAME],
        pytest.param(sorted(MORE_OF_THE_SAME), marks=SLOW),
    ],
    ids=["most", "rest"],
)
def test_every_way_to_fail_costs_one_row_and_leaves_the_others_as_they_were(suite, kinds):
    wrecked = suite(kinds)
    records = guarded(wrecked).rows
    assert len(records) == len(wrecked.estimators)
    assert_failures(records, kinds)
    assert_others_are_those_of_a_run_without(wrecked, records)


def test_what_is_strange_but_no_failure_leaves_the_others_as_they_were(suite, capfd):
    wrecked = suite(STRANGE)
    records = guarded(wrecked).rows
    assert set(records["status"]) == {"ok"}
    assert_others_are_those_of_a_run_without(wrecked, records)


def test_without_a_guard_what_can_be_caught_leaves_the_others_as_they_were(suite):
    wrecked = suite(HARMLESS_UNGUARDED)
    before = Path.cwd(), dict(os.environ)
    records = run_suite(wrecked).rows
    assert_failures(records, set(HARMLESS_UNGUARDED) & set(FAILURES))
    assert_others_are_those_of_a_run_without(wrecked, records)
    assert (Path.cwd(), dict(os.environ)) == before


@pytest.mark.parametrize(
    "kind", ["loop", *(pytest.param(kind, marks=SLOW) for kind in ("loop_in_c", "freeze"))]
)
def test_a_cell_that_never_ends_whatever_it_ignores_is_stopped_and_the_rest_goes_on(suite, kind):
    wrecked = suite([kind])
    records = guarded(wrecked, timeout_s=2).rows
    assert of_kind(records, kind)[["status", "reason"]].values.tolist() == [["timeout", "more than 2 s"]]
    assert (of_kind(records, kind)["time_estimate_s"] >= 2).all()
    assert_others_are_those_of_a_run_without(wrecked, records)


def is_running(process_id):
    try:
        state = Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state not in "ZX"


def test_children_of_a_plugin_end_with_the_run(suite, tmp_path):
    path = tmp_path / "children"
    guarded(suite([]).replace(estimators=[f"wreck[kind=[child_and_die,child],path={path}]"]))
    children = [int(number) for number in path.read_text().split()]
    assert len(children) == 2
    deadline = time.monotonic() + 30
    while any(map(is_running, children)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(map(is_running, children))


@SLOW
def test_the_number_of_processes_changes_nothing(suite):
    wrecked = suite(["raise_", "exit7", "unlock", "disturb"], trials=3, snr_db=[-10, 0, 10])
    one, two, many = (guarded(wrecked, n_jobs=n) for n in (1, 2, 5))
    for other in (two, many):
        pd.testing.assert_frame_equal(one.rows.drop(columns=TIMES), other.rows.drop(columns=TIMES))
        assert [cloud.tobytes() for cloud in one.points] == [cloud.tobytes() for cloud in other.points]


BROKEN_IN_WORKERS = """
import multiprocessing, os
from dataclasses import dataclass

from isacbench.model.cloud import PointCloud

if multiprocessing.parent_process() is not None:
    {what}


@dataclass(frozen=True)
class Homebody:
    name = "homebody"

    def estimate(self, observation):
        return PointCloud.empty()
"""


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("raise OSError('not here')", r"plugin homebody\.py: cannot be imported: line 8: OSError: not here"),
        (
            "os._exit(3)",
            r"scenario tiny, trial \d, 0 dB: 3 worker processes in a row died while simulating the "
            "observation; the last: the process exited with code 3",
        ),
        pytest.param("os._exit(0)", "died while simulating the observation", marks=SLOW),
    ],
)
def test_a_plugin_that_breaks_in_workers_alone_ends_the_run_with_one_message(
    write_plugin, tiny, tmp_path, what, message
):
    load_plugin_file(write_plugin("homebody.py", BROKEN_IN_WORKERS.format(what=what)))
    suite = Suite(name="test", scenarios=[str(tiny)], estimators=["homebody"], snr_db=[0], trials=3)
    with pytest.raises(InputError, match=message):
        run_suite(suite, tmp_path / "run", options=RunOptions(jobs=2))


@SLOW
def test_versions_of_a_process_that_leaves_while_it_loads_plugins_are_not_waited_for(write_plugin, tiny):
    load_plugin_file(write_plugin("homebody.py", BROKEN_IN_WORKERS.format(what="os._exit(0)")))
    suite = Suite(name="test", scenarios=[str(tiny)], estimators=["homebody"], snr_db=[0], trials=1)
    with (
        Worker(load_job(suite).parts, Limits(timeout_s=None)) as worker,
        pytest.raises(InputError, match="loading the plugins: the process exited with code 0"),
    ):
        worker.versions()


@pytest.fixture
def endless(suite):
    """Return a worker and a function that lets it work in a thread on a cell that never ends.

    What ended the work comes from the queue that the function returns.
    """
    job = load_job(suite([]).replace(estimators=["wreck[kind=loop]", "good"]))
    ended = SimpleQueue()

    def work():
        try:
            ended.put(list(worker.rows(job.plan.blocks())))
        except BaseException as error:
            ended.put(error)

    def start():
        Thread(target=work, daemon=True).start()
        return ended

    with Worker(job.parts, Limits()) as worker:
        yield worker, start


@pytest.mark.parametrize("delay_s", [0, 0.2, *(pytest.param(t, marks=SLOW) for t in (0.05, 0.1, 1))])
def test_a_busy_worker_can_be_stopped_from_another_thread_at_any_moment(endless, delay_s):
    worker, start = endless
    ended = start()
    time.sleep(delay_s)
    worker.stop()
    assert isinstance(ended.get(timeout=60), CancelledError)


def test_a_run_that_is_left_early_ends_its_processes(suite):
    job = load_job(suite([]).replace(trials=3))
    outcomes = rows_guarded(job, job.plan.blocks(), Limits(), 2)
    next(outcomes)
    before = {child.pid for child in active_children()}
    assert before
    outcomes.close()
    assert not {child.pid for child in active_children()} & before


def test_a_run_without_a_cell_left_starts_nothing(suite):
    assert list(rows_guarded(load_job(suite([])), [], Limits(), 2)) == []


def test_a_process_that_dies_of_an_earlier_cell_costs_the_present_one_nothing(suite):
    records = guarded(suite(["later", "nap"])).rows
    assert set(records["status"]) == {"ok"}
    assert len(records) == 8


@pytest.mark.parametrize(
    ("make", "options", "message"),
    [
        (Limits, {"timeout_s": 0}, "timeout 0 s: allowed is more than 0, and finite"),
        (Limits, {"timeout_s": float("nan")}, "timeout nan s"),
        (Limits, {"memory_mib": float("inf")}, "memory inf MiB: allowed is more than 0, and finite"),
        (RunOptions, {"timeout_s": 1}, "timeout_s and memory_mib limit worker processes: give jobs or dask"),
        (RunOptions, {"timing": True, "repeats": 0}, "repeats 0: allowed is 1 or more"),
    ],
)
def test_options_that_mean_nothing_are_refused(make, options, message):
    with pytest.raises(InputError, match=message):
        make(**options)


def test_a_worker_does_not_repeat_what_the_process_that_plans_has_warned_of(monkeypatch):
    for name in ("_job", "_messages"):
        monkeypatch.setattr(worker_module, name, None, raising=False)
    monkeypatch.setattr(gc, "freeze", lambda: None)
    with warnings.catch_warnings():
        worker_module._start(None, Limits(memory_mib=1), None)
        warnings.warn("a scatterer is far away", InputWarning, stacklevel=1)


def test_workers_keep_to_scenarios_of_their_own_and_share_one_only_at_the_end():
    todo = {name: deque((Block(name, trial, 0.0, ()),) for trial in range(2)) for name in "abc"}
    first, second = (worker_module._taken(todo, Lock()) for _ in range(2))
    taken = [next(thread)[:2] for _ in range(3) for thread in (first, second)]
    assert taken == [("a", 0), ("b", 0), ("a", 1), ("b", 1), ("c", 0), ("c", 1)]
    assert [*first, *second] == []
