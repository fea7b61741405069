"""Progress is shown where somebody looks, in words that are right, and costs no waiting."""

import sys
from types import SimpleNamespace

import pytest

from isacbench.bench.run import progress
from isacbench.bench.run.progress import notebook_display, paced_progress, progress_shown
from isacbench.bench.run.runner import run


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
def kernel(monkeypatch):
    """Pretend that this is the kernel of a notebook; what it displays is returned."""
    display = Display()
    ipython = SimpleNamespace(get_ipython=lambda: SimpleNamespace(kernel=object()))
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(display=display))
    return display


@pytest.fixture
def told():
    """Return the texts that were told."""
    return []


@pytest.fixture
def minutely(clock, told):
    return paced_progress("cells", lambda text, *_: told.append(text), 60, clock=clock)


def test_a_line_is_written_when_a_minute_has_passed_and_not_before(clock, minutely, told):
    for n_done in range(1, 661):
        clock.time_s += 0.75
        minutely(n_done, 660)
    assert len(told) == 8
    assert told[2] == "240 of 660 cells, 0:03:00, about 0:05:15 left"


def test_what_an_earlier_call_has_done_does_not_count_as_speed(clock, minutely, told):
    clock.time_s += 30
    minutely(601, 660)
    clock.time_s += 30
    minutely(602, 660)
    assert told == ["602 of 660 cells, 0:01:00, about 0:29:00 left"]


def test_the_first_and_the_last_piece_are_told_if_wanted(clock, told):
    progress = paced_progress("cells", lambda text, *_: told.append(text), 0.3, with_ends=True, clock=clock)
    assert not told
    for n_done in range(1, 11):
        clock.time_s += 0.1
        progress(n_done, 10)
    assert 3 <= len(told) <= 6
    assert (told[0][:10], told[-1]) == ("1 of 10 ce", "10 of 10 cells, 0:00:01")


def test_a_notebook_shows_one_line_that_changes(kernel):
    with progress_shown("<b>") as show:
        for n_done in range(1, 11):
            show(n_done, 10)
    assert repr(kernel.shown[-1]) == "<b>: 10 of 10 cells, 0:00:00"
    assert kernel.shown[-1]._repr_html_() == (
        '<progress value="10" max="10"></progress> &lt;b&gt;: 10 of 10 cells, 0:00:00'
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
