"""The report of a run: figures and page, of which each is there without the other."""

import pytest

from isacbench.bench.run.runner import run_suite
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputWarning
from isacbench.report import figures, run_report
from isacbench.report.figures import new_figure
from isacbench.report.html import page_content
from isacbench.report.run_report import draw_with_page

NAMES = ["deviation.png", "curves-tiny.png", "radii.png", "clouds-tiny.png"]


@pytest.fixture
def run(tiny, tmp_path):
    return run_suite(
        Suite(name="t", scenarios=[str(tiny)], estimators=["fft4d"], snr_db=[0], trials=1), tmp_path / "run"
    )


@pytest.fixture(autouse=True)
def _empty_here(monkeypatch):
    """Leave figures empty."""
    for module, name in ((figures, "draw_charts"), (run_report, "draw_clouds")):
        monkeypatch.setattr(module, name, lambda *_: new_figure(1, 1))


def names_of(paths):
    return [path.name for path in paths]


def test_figures_and_page_of_a_run_are_written_and_the_page_can_be_left_out(run):
    assert names_of(draw_with_page(run, with_page=False)) == NAMES
    assert not (run.folder / "report.html").exists()
    assert names_of(draw_with_page(run)) == [*NAMES, "report.html"]


def test_a_run_of_too_many_rows_has_its_figures_and_a_warning_in_place_of_the_page(run, monkeypatch):
    monkeypatch.setattr(page_content, "MOST_ROWS", 0)
    with pytest.warns(InputWarning, match="no page: .*1 rows are too many for a page; allowed are 0"):
        assert names_of(draw_with_page(run)) == NAMES


def test_a_run_without_any_figure_has_its_page(run, monkeypatch):
    monkeypatch.setattr("isacbench.report.run_report.draw_run", lambda _run: [])
    assert names_of(draw_with_page(run)) == ["report.html"]
