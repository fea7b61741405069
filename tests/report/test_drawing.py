"""The process that draws beside this one: calls are shared, and none is lost with it."""

import multiprocessing
import operator
import os
import time
from functools import partial
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


@pytest.fixture
def ready(monkeypatch):
    """Process that has begun; it imports this module also where tests run from no folder on the path."""
    monkeypatch.syspath_prepend(Path(__file__).parents[2])
    monkeypatch.setattr(drawing, "START_S", 0.0)
    with DrawingProcess("isacbench.report.figures") as process:
        wait_for(lambda: process.has_begun)
        process.share(str, [])  # which comes after all that makes it ready
        yield process


def wait_for(is_so):
    until_s = time.monotonic() + 60
    while not is_so():
        assert time.monotonic() < until_s
        time.sleep(0.01)


def note(folder, number, here=None, there=None):
    """Write which process makes a call, wait for a call in the other, and go on as this one shall."""
    place, deed = ("there", there) if multiprocessing.parent_process() else ("here", here)
    (folder / f"{number}-{place}").touch()
    wait_for(lambda: {path.name[2:] for path in folder.iterdir()} == {"here", "there"})
    if deed is not None:
        deed()


def test_calls_are_shared_and_each_is_made_once(ready, tmp_path):
    ready.share(note, [(tmp_path, number) for number in range(6)])
    assert sorted(path.name[0] for path in tmp_path.iterdir()) == [*"012345"]


def test_what_a_process_was_lost_with_is_called_here(ready, tmp_path):
    ready.share(note, [(tmp_path, number, None, partial(os._exit, 1)) for number in range(4)])
    assert {path.name[0] for path in tmp_path.glob("*-here")} == {*"0123"}


def test_the_process_draws_the_same_picture(ready, tmp_path):
    ((_, draw),) = drawings_of(GROUPS[:1])
    ready.call(draw_and_save, draw, tmp_path / "there.png")
    draw_and_save(draw, tmp_path / "here.png")
    assert (tmp_path / "there.png").read_bytes() == (tmp_path / "here.png").read_bytes()
    paths = save_figures(drawings_of(GROUPS), tmp_path, helper=ready)
    assert [path.name for path in paths if path.exists()] == ["first.png", "second.png"]


def test_an_error_here_ends_the_process_at_once(ready, tmp_path):
    deeds = partial(operator.truediv, 1, 0), partial(time.sleep, 600)
    with pytest.raises(ZeroDivisionError), ready:
        ready.share(note, [(tmp_path, number, *deeds) for number in range(4)])
    assert not ready.has_begun


def test_a_short_run_starts_no_process():
    called = []
    with DrawingProcess("isacbench.report.figures") as process:
        process.share(called.append, [(1,), (2,)])
        assert not process.has_begun
    assert called == [1, 2]
