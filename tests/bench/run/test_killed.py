"""Real runs in processes of their own, ended from outside at any moment, and gone on with."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from contextlib import suppress
from functools import partial
from pathlib import Path

import pandas as pd
import psutil
import pytest

from isacbench.bench.cells.rows import TIMES
from isacbench.bench.run.runner import run_suite
from isacbench.bench.store.run import Run
from isacbench.bench.suites.suite_kinds import load_suite
from isacbench.plugins.discovery import isolated_plugins, load_plugin_file
from tests.conftest import DRAW_NOTHING, PATIENCE_S, wait_until

pytestmark = pytest.mark.first

SLUGGISH = f'''
import ctypes, os, signal, sys, time
from collections import deque
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from typing import ClassVar

import numpy as np

from isacbench.model.cloud import PointCloud

{DRAW_NOTHING}
if os.environ.get("DIE_AT_STEP"):
    steps, replace = iter(range(100)), Path.replace

    def replace_and_die(path, target):
        replace(path, target)
        if next(steps) == int(os.environ["DIE_AT_STEP"]):
            os.kill(os.getpid(), signal.SIGKILL)

    Path.replace = replace_and_die


@dataclass(frozen=True)
class Sluggish:
    """Takes its time, as long as the environment says so."""

    name: ClassVar[str] = "sluggish"
    n: int = 1

    def estimate(self, observation):
        time.sleep(float(os.environ.get("SLUGGISH_S", "0")))
        if os.environ.get("STUCK"):
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
            deque(repeat(None), maxlen=0)  # in C, and never lets go of the interpreter
        values = np.abs(observation.cells).ravel()[:3]
        return PointCloud([values], [0.0], [1.0])
'''

ESTIMATORS = ["sluggish[n=1]", "sluggish[n=2]", "sluggish[n=3]"]


@pytest.fixture
def plugin(tmp_path):
    path = tmp_path / "sluggish.py"
    path.write_text(SLUGGISH)
    return path


@pytest.fixture
def command(tiny, plugin):
    """Arguments of a run of 30 cells."""
    grid = ["--snr", "0,10", "--trials", "5", "--scenario", tiny, "--plugin", plugin]
    return [*grid, *(word for text in ESTIMATORS for word in ("-e", text))]


@pytest.fixture
def start(command, tmp_path):
    """Return a function that starts a run in a process group of its own; all groups end with the test."""
    groups = []

    def call(folder, *options, **environment):
        words = [sys.executable, "-m", "isacbench", "run", "quick", "-o", folder, *command, *options]
        with (tmp_path / "output.txt").open("w") as output:
            process = subprocess.Popen(
                [str(word) for word in words],
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                # Processes that a shell runs in the background inherit that interrupts are ignored.
                preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),
                env={**os.environ, **environment},
            )
        groups.append(process)
        return process

    yield call
    for process in groups:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def rows_in(folder):
    journal = folder / "journal.jsonl"
    return journal.read_bytes().count(b'{"row":') if journal.exists() else 0


def table(folder):
    records = pd.read_csv(folder / "results.csv", dtype=str).drop(columns=TIMES)
    return records.to_csv(), pd.read_parquet(folder / "clouds.parquet").to_csv()


@pytest.fixture
def finish(tiny, plugin):
    """Return a function that goes on with a run in this process, undisturbed, and returns its tables."""
    with isolated_plugins():
        load_plugin_file(plugin)
        suite = load_suite("quick").replace(
            scenarios=[str(tiny)], estimators=ESTIMATORS, snr_db=[0, 10], trials=5
        )

        def call(folder):
            run_suite(suite, folder)
            return table(folder)

        yield call


@pytest.fixture
def undisturbed(finish, shelf):
    folder = shelf / "undisturbed"
    return table(folder) if folder.exists() else finish(folder)


def running(marker):
    """Processes whose environment holds a marker: a run, its workers and all that they have started."""
    found = []
    for process in psutil.process_iter():
        with suppress(psutil.Error):
            if process.environ().get("MARKER") == marker and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
    return found


def busy(marker):
    """Number of such processes that have computed for some seconds, as those that are stuck do."""
    n_busy = 0
    for process in running(marker):
        with suppress(psutil.Error):  # it has ended meanwhile
            n_busy += process.cpu_times().user > 4
    return n_busy


linux = pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="looks for processes in /proc")


@linux
def test_a_killed_run_leaves_its_rows_no_process_and_no_lock(start, finish, tmp_path, undisturbed):
    folder, marker = tmp_path / "run", f"run of {tmp_path}"
    process = start(folder, "-j", "1", SLUGGISH_S="0.5", MARKER=marker)
    wait_until(lambda: rows_in(folder) >= 4)
    assert len(running(marker)) >= 3
    process.kill()
    process.wait()
    wait_until(lambda: not running(marker))
    n_rows = rows_in(folder)
    assert len(Run.open(folder).rows) == n_rows
    assert finish(folder) == undisturbed


@linux
@pytest.mark.slow
def test_not_even_a_worker_that_never_returns_to_the_interpreter_outlives_its_run(start, tmp_path):
    folder, marker = tmp_path / "run", f"run of {tmp_path}"
    process = start(folder, "-j", "2", STUCK="yes", MARKER=marker)
    wait_until(lambda: busy(marker) >= 2)
    process.kill()
    process.wait()
    wait_until(lambda: not running(marker))


def from_the_keyboard(process, _marker):
    os.killpg(process.pid, signal.SIGINT)


def by_what_ends_all_processes_of_a_job(process, marker):
    """Send SIGTERM to workers and their server first, and to the run when they may be dead."""
    for other in running(marker):
        if other.pid != process.pid:
            other.terminate()
    time.sleep(0.3)
    process.terminate()


@linux
@pytest.mark.parametrize(
    ("interrupt", "code"),
    [
        (from_the_keyboard, 130),
        (by_what_ends_all_processes_of_a_job, 143),
    ],
)
def test_an_interrupt_writes_the_rows_so_far(start, finish, tmp_path, undisturbed, interrupt, code):
    folder, marker = tmp_path / "run", f"run of {tmp_path}"
    process = start(folder, "-j", "2", SLUGGISH_S="0.5", MARKER=marker)
    wait_until(lambda: rows_in(folder) >= 4)
    interrupt(process, marker)
    assert process.wait(PATIENCE_S) == code
    output = (tmp_path / "output.txt").read_text()
    assert "Traceback" not in output
    assert f"cells so far are in {folder}" in output.replace("\n", "")
    wait_until(lambda: not running(marker))
    assert not (folder / "journal.jsonl").exists()
    assert json.loads((folder / "manifest.json").read_text())["interrupted"] is True
    records = Run.open(folder).rows
    assert 4 <= len(records) < 30
    assert set(records["status"]) == {"ok"}
    assert (folder / "summary.md").exists()
    assert finish(folder) == undisturbed


@pytest.mark.slow
@pytest.mark.parametrize("step", range(8))
def test_a_run_that_is_killed_while_it_writes_tables_goes_on(start, finish, tmp_path, undisturbed, step):
    folder = tmp_path / "run"
    process = start(folder, "-j", "1", DIE_AT_STEP=str(step))
    code = process.wait(PATIENCE_S)
    assert code == (-signal.SIGKILL)
    assert finish(folder) == undisturbed


@pytest.mark.slow
@pytest.mark.parametrize("moment", range(8))
def test_a_run_that_is_killed_at_any_moment_goes_on(start, finish, tmp_path, undisturbed, moment):
    folder = tmp_path / "run"
    for attempt in range(3):
        process = start(folder, "-j", "2", SLUGGISH_S="0.05")
        time.sleep(random.Random(f"{moment} {attempt}").uniform(0, 4))
        process.kill()
        process.wait()
    assert finish(folder) == undisturbed


@pytest.mark.slow
@pytest.mark.parametrize("moment", range(6))
def test_an_interrupt_at_any_moment_is_no_traceback_and_goes_on(start, finish, tmp_path, undisturbed, moment):
    folder = tmp_path / "run"
    process = start(folder, "-j", "2", SLUGGISH_S="0.05")
    time.sleep(random.Random(moment).uniform(2, 5))
    os.killpg(process.pid, signal.SIGINT)
    process.wait(PATIENCE_S)
    assert "Traceback" not in (tmp_path / "output.txt").read_text()
    assert finish(folder) == undisturbed


@linux
@pytest.mark.slow
@pytest.mark.parametrize("delay_s", [0.05, 0.3, 1])
def test_an_impatient_interrupt_ends_the_run_as_well(start, finish, tmp_path, undisturbed, delay_s):
    folder, marker = tmp_path / "run", f"run of {tmp_path}"
    process = start(folder, "-j", "2", SLUGGISH_S="0.5", MARKER=marker)
    wait_until(lambda: rows_in(folder) >= 4)
    for _ in range(3):
        os.killpg(process.pid, signal.SIGINT)
        time.sleep(delay_s)
    assert process.wait(PATIENCE_S) != 0
    wait_until(lambda: not running(marker))
    assert finish(folder) == undisturbed
