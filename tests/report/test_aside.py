import pytest

from isacbench.bench.runner import run_suite
from isacbench.bench.suite import Suite
from isacbench.entries import isolated_plugins, register_plugin
from isacbench.errors import InputWarning
from isacbench.plugin_files import PluginFile
from isacbench.report import aside
from isacbench.report.aside import Aside
from isacbench.report.figures import draw_run

SHOWING = """
import os
from dataclasses import dataclass
from typing import ClassVar

from isacbench.model.cloud import PointCloud


@dataclass(frozen=True)
class Showing:
    name: ClassVar[str] = "showing"
    deed: str = "raise"

    def estimate(self, observation):
        return PointCloud.empty()

    def diagnose(self, observation):
        if self.deed == "exit":
            os._exit(3)
        while self.deed == "hang":
            pass
        raise ZeroDivisionError("no luck")
"""


@pytest.fixture
def run_of(tiny, tmp_path):
    """Run an estimator that shows its work, and return the folder."""

    def make(estimator):
        suite = Suite(name="t", scenarios=[str(tiny)], estimators=[estimator], snr_db=[0], trials=1)
        run_suite(suite, tmp_path / "run")
        return tmp_path / "run"

    with isolated_plugins():
        register_plugin(PluginFile("showing.py", SHOWING))
        yield make


def test_two_processes_draw_what_one_does(run_of):
    folder = run_of("music2d")
    together = draw_run(folder)
    assert [path.name for path in together] == [
        "deviation.png",
        "curves-tiny.png",
        "clouds-tiny.png",
        "rdm-music2d.png",
        *(path.name for path in together if path.name.startswith("spectrum")),
    ]
    with Aside() as hand:
        hand.get_ready()
        assert hand.draw_run(folder) == together


@pytest.mark.parametrize(
    ("deed", "message"),
    [
        ("raise", r"no map and no spectra of showing.*: ZeroDivisionError: no luck"),
        ("exit", r"no maps and no spectra: the process exited with code 3"),
        ("hang", r"no maps and no spectra: more than 1 s"),
    ],
)
def test_a_diagnosis_that_fails_is_told_and_costs_no_other_figure(run_of, monkeypatch, deed, message):
    # On a busy machine a process may take more than a second to raise or to end.
    monkeypatch.setattr(aside, "TIMEOUT_S", 1.0 if deed == "hang" else 60.0)
    folder = run_of(f"showing[deed={deed}]")
    with Aside() as hand, pytest.warns(InputWarning, match=message):
        assert [path.name for path in hand.draw_run(folder)][:2] == ["deviation.png", "curves-tiny.png"]
