"""Pages of runs whose plugins fail, hang or end their process while the page is made."""

import pytest

from isacbench.bench.run.runner import run_suite
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputWarning
from isacbench.report.drawing.style import new_figure
from isacbench.report.figures import run_figures
from isacbench.report.html import guarded_pages, page_content
from isacbench.report.html.guarded_pages import draw_run_and_page


@pytest.fixture
def run_of(tiny, tmp_path, showing):
    """Run an estimator that shows its work, and return the folder."""

    def make(estimator):
        suite = Suite(name="t", scenarios=[str(tiny)], estimators=[estimator], snr_db=[0], trials=1)
        folder = tmp_path / estimator.strip("]").rpartition("=")[2]
        run_suite(suite, folder)
        return folder

    return make


@pytest.fixture(autouse=True)
def _empty_here(monkeypatch):
    """Leave figures empty."""
    for name in ("draw_deviations", "draw_scores", "draw_clouds"):
        monkeypatch.setattr(run_figures, name, lambda *_: new_figure(1, 1))


def test_figures_and_page_of_a_run_are_written_and_the_page_can_be_left_out(run_of):
    folder = run_of("music2d")
    names = ["deviation.png", "curves-tiny.png", "radii.png", "clouds-tiny.png"]
    assert [path.name for path in draw_run_and_page(folder, with_page=False)] == names
    assert not (folder / "report.html").exists()
    assert [path.name for path in draw_run_and_page(folder)] == [*names, "report.html"]


def test_a_run_of_too_many_rows_has_its_figures_and_a_warning_in_place_of_the_page(run_of, monkeypatch):
    folder = run_of("fft4d")
    monkeypatch.setattr(page_content, "MOST_ROWS", 0)
    with pytest.warns(InputWarning, match="no page: .*1 rows are too many for a page; allowed are 0"):
        drawn = [path.name for path in draw_run_and_page(folder)]
    assert drawn == ["deviation.png", "curves-tiny.png", "radii.png", "clouds-tiny.png"]


def test_a_diagnosis_that_fails_is_told_and_costs_neither_figures_nor_page(run_of, monkeypatch):
    for deed, message in (
        ("raise", r"no map and no spectra of showing.*: ZeroDivisionError: no luck"),
        ("hang", r"no maps in the page: more than 1 s"),
        ("exit", r"no maps in the page: the process exited with code 3"),
    ):
        # On a busy machine a process may take more than a second to raise or to end.
        monkeypatch.setattr(guarded_pages, "TIMEOUT_S", 1.0 if deed == "hang" else 60.0)
        folder = run_of(f"showing[deed={deed}]")
        with pytest.warns(InputWarning, match=message):
            drawn = [path.name for path in draw_run_and_page(folder)]
        assert drawn == ["deviation.png", "curves-tiny.png", "radii.png", "clouds-tiny.png", "report.html"], (
            deed
        )
