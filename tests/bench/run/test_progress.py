"""Progress is shown where somebody looks, in words that are right, and costs no waiting."""

import sys
from types import SimpleNamespace

import pytest

from isacbench.bench.run import progress
from isacbench.bench.run.progress import MinuteLines, NotebookLine, notebook_display, progress_shown
from isacbench.bench.run.runner import run


class Clock:
    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s


class Display:
    """Records what a notebook is given, and what takes its place."""

    def __init__(self):
        self.shown = []

    def __call__(self, shown, display_id):
        assert display_id is True
        self.update(shown)
        return self

    def update(self, shown):
        self.shown.append(shown)


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def kernel(monkeypatch):
    """Pretend that this is the kernel of a notebook; what it displays is returned."""
    display = Display()
    ipython = SimpleNamespace(get_ipython=lambda: SimpleNamespace(kernel=object()))
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(display=display))
    return display


def test_a_line_is_written_when_a_minute_has_passed_and_not_before(clock):
    lines = []
    tell = MinuteLines("cells", lines.append, clock)
    for n_done in range(1, 661):
        clock.now_s += 0.75
        tell(n_done, 660)
    assert len(lines) == 8
    assert lines[2] == "isacbench: 240 of 660 cells, 3 min, about 5 min left"


def test_what_an_earlier_call_has_done_does_not_count_as_speed(clock):
    lines = []
    tell = MinuteLines("cells", lines.append, clock)
    clock.now_s += 30
    tell(601, 660)
    clock.now_s += 30
    tell(602, 660)
    assert lines == ["isacbench: 602 of 660 cells, 1 min, about 29 min left"]


@pytest.mark.parametrize(("passed_s", "told"), [(9, "9 s"), (150, "2 min"), (7500, "2 h 5 min")])
def test_times_are_told_as_people_do(clock, passed_s, told):
    display = Display()
    line = NotebookLine("paper", "cells", display, clock)
    clock.now_s += passed_s
    line(3, 3)
    assert repr(display.shown[-1]) == f"paper: 3 of 3 cells, {told}"


def test_a_notebook_shows_one_line_that_changes_now_and_then_and_ends_with_the_last_word(clock):
    display = Display()
    line = NotebookLine("<b>", "cells", display, clock)
    assert not display.shown
    for n_done in range(1, 11):
        clock.now_s += 0.1
        line(n_done, 10)
    line.close()
    told = [repr(shown) for shown in display.shown]
    assert 3 <= len(told) <= 6
    assert told[-1] == "<b>: 10 of 10 cells, 1 s"
    assert display.shown[-1]._repr_html_() == (
        '<progress value="10" max="10"></progress> &lt;b&gt;: 10 of 10 cells, 1 s'
    )


def test_nothing_appears_in_a_notebook_where_nothing_is_done(kernel):
    with progress_shown("paper"):
        pass
    assert not kernel.shown


def test_only_a_kernel_is_a_notebook(kernel, monkeypatch):
    assert notebook_display() is kernel
    for shell in (None, SimpleNamespace(), SimpleNamespace(kernel=None)):
        monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda shell=shell: shell))
        assert notebook_display() is None
    monkeypatch.delitem(sys.modules, "IPython")
    assert notebook_display() is None


def wanted(tiny, **options):
    return run("quick", scenarios=[tiny], estimators=["seer"], snr_db=[0], trials=3, **options)


def test_a_run_shows_progress_in_a_notebook_unless_told_not_to(plugins, tiny, kernel, capsys):
    wanted(tiny, progress=False)
    assert not kernel.shown
    wanted(tiny)
    assert repr(kernel.shown[-1]).startswith("quick: 3 of 3 cells, ")
    assert capsys.readouterr() == ("", "")


def test_a_run_is_silent_in_a_script_unless_told_to_show(plugins, tiny, capsys, monkeypatch):
    monkeypatch.setattr(progress, "LINE_S", 0.0)
    wanted(tiny)
    assert capsys.readouterr() == ("", "")
    wanted(tiny, progress=True)
    lines = capsys.readouterr().err.splitlines()
    assert [line.partition(",")[0] for line in lines] == [f"isacbench: {n} of 3 cells" for n in (1, 2, 3)]


def test_a_terminal_gets_a_bar(monkeypatch, capsys):
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    with progress_shown("paper") as show:
        show(1, 2)
    assert "1/2" in capsys.readouterr().err


def test_lines_have_nowhere_to_go_where_stderr_is_closed(monkeypatch, capsys):
    monkeypatch.setattr(progress, "LINE_S", 0.0)
    monkeypatch.setattr(sys, "stderr", None)
    with progress_shown("paper") as show:
        show(1, 2)
    assert capsys.readouterr().out == ""
