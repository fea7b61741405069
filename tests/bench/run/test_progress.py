"""Progress is shown where somebody looks, in words that are right, and costs no waiting."""

import sys

import pytest

from isacbench.bench.run import progress
from isacbench.bench.run.progress import paced_progress, progress_shown
from isacbench.bench.run.runner import run


@pytest.fixture
def lines():
    """Return the lines that were written."""
    return []


@pytest.fixture
def minutely(clock, lines):
    return paced_progress("cells", lines.append, 60, clock=clock)


def test_a_line_is_written_when_a_minute_has_passed_and_not_before(clock, minutely, lines):
    for n_done in range(1, 661):
        clock.time_s += 0.75
        minutely(n_done, 660)
    assert len(lines) == 8
    assert lines[2] == "240 of 660 cells, 0:03:00, about 0:05:15 left"


def test_what_an_earlier_call_has_done_does_not_count_as_speed(clock, minutely, lines):
    clock.time_s += 30
    minutely(601, 660)
    clock.time_s += 30
    minutely(602, 660)
    assert lines == ["602 of 660 cells, 0:01:00, about 0:29:00 left"]


def wanted(tiny, **options):
    return run("quick", scenarios=[tiny], estimators=["seer"], snr_db=[0], trials=3, **options)


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
