"""The process that draws beside this one: calls are shared, and none is lost with it."""

import multiprocessing
import os
import sys
import time
from pathlib import Path

import pytest

from isacbench.charts import Axis, Chart, ChartGroup, Series
from isacbench.report import drawing
from isacbench.report.drawing import DrawingProcess
from isacbench.report.figures import draw_and_save, drawings_of, save_figures

GROUPS = [
    ChartGroup(stem, "both", [Chart("one", Axis("x"), Axis("y", log=True), [Series("a", [1, 2], [3, 400])])])
    for stem in ("first", "second")
]


@pytest.fixture(scope="module", autouse=True)
def importable():
    """Let the other process import this module, also where tests run from no folder on the path."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "path", [*sys.path, str(Path(__file__).parents[2])])
        yield


@pytest.fixture(scope="module")
def ready(importable):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drawing, "START_S", 0.0)
        process = DrawingProcess("isacbench.report.figures")
    with process:
        wait_for(lambda: process.has_begun)
        yield process


def wait_for(is_so):
    until_s = time.monotonic() + 60
    while not is_so():
        assert time.monotonic() < until_s
        time.sleep(0.01)


def place():
    """Say where a call is made: in the process of the tests or in the other one."""
    return "there" if multiprocessing.parent_process() else "here"


def note(folder, number):
    """Write which process has made a call; the first ones wait for each other."""
    (folder / f"{number}-{place()}").touch()
    wait_for(lambda: list(folder.glob("*-here")))
    wait_for(lambda: list(folder.glob("*-there")))


def note_or_end(folder, number):
    """Make a call here, once a process has ended in one."""
    (folder / f"{number}-{place()}").touch()
    if place() == "there":
        os._exit(1)
    wait_for(lambda: list(folder.glob("*-there")))


def fail_here(folder):
    if place() == "here":
        wait_for(lambda: list(folder.glob("there")))
        raise ZeroDivisionError
    (folder / "there").touch()
    time.sleep(60)
    (folder / "waited").touch()


def test_calls_are_shared_and_each_is_made_once(ready, tmp_path):
    ready.share(note, [(tmp_path, number) for number in range(6)])
    made = [path.name.split("-") for path in tmp_path.iterdir()]
    assert sorted(number for number, _ in made) == [*"012345"]
    assert {name for _, name in made} == {"here", "there"}


def test_what_a_process_was_lost_with_is_called_here(ready, tmp_path):
    ready.share(note_or_end, [(tmp_path, number) for number in range(4)])
    assert {path.name for path in tmp_path.glob("*-here")} == {f"{number}-here" for number in range(4)}


def test_the_process_draws_the_same_picture(ready, tmp_path):
    ((_, draw),) = drawings_of(GROUPS[:1])
    ready.call(draw_and_save, draw, tmp_path / "there.png")
    draw_and_save(draw, tmp_path / "here.png")
    assert (tmp_path / "there.png").read_bytes() == (tmp_path / "here.png").read_bytes()
    paths = save_figures(drawings_of(GROUPS), tmp_path, helper=ready)
    assert [path.name for path in paths if path.exists()] == ["first.png", "second.png"]


def test_an_error_here_ends_the_process_at_once(tmp_path):
    with DrawingProcess("isacbench.report.figures") as process:
        process.call(str)
        with pytest.raises(ZeroDivisionError):
            process.share(fail_here, [(tmp_path,)] * 4)
        assert not process.has_begun
    assert not (tmp_path / "waited").exists()


def test_a_short_run_starts_no_process(tmp_path):
    called = []
    with DrawingProcess("isacbench.report.figures") as process:
        process.share(called.append, [(1,), (2,)])
        assert not process.has_begun
    assert called == [1, 2]
