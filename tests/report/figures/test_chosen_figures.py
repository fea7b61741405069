"""Figures for a paper: what is chosen is drawn, and nothing else."""

import itertools
import sys

import pytest

from isacbench.bench.run.runner import run_suite
from isacbench.bench.store.run import Run
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputError, InputWarning
from isacbench.plugins.contracts import Diagnoser
from isacbench.plugins.registry import get_estimator
from isacbench.report import clouds, diagnoses, figures, run_report
from isacbench.report.figures import new_figure
from isacbench.report.run_report import FigureChoice, draw_chosen

SHOWING = '''
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isacbench.plugins.contracts import Detection, Diagnosis, Spectrum
from isacbench.model.cloud import PointCloud


@dataclass(frozen=True)
class Shower:
    """Shows its work, or fails to."""

    name: ClassVar[str] = "shower"
    detects: bool = True
    fails: bool = False

    def estimate(self, observation):
        return PointCloud.empty()

    def diagnose(self, observation):
        if self.fails:
            raise ZeroDivisionError("no luck")
        gate = observation.gate
        power = np.mean(np.abs(observation.cells) ** 2, axis=(2, 3))
        detection = Detection(power > 5, np.full_like(power, 5.0), np.ones_like(power))
        cosine = np.linspace(-1, 1, 11)
        spectra = tuple(Spectrum(cosine, -(cosine**2), -0.5, np.zeros(1), label) for label in "uw")
        cell = int(gate.range_bins[5]), 0
        return Diagnosis(
            power,
            detection,
            gate.range_bins,
            gate.doppler_bins,
            spectra if self.detects else (),
            cell if self.detects else None,
        )
'''


@pytest.fixture
def shower(plugins, plugin_folder):
    """Install the estimator shower beside the others."""
    sys.modules.pop("showing_plugins", None)
    plugin_folder.install("showing-plugins", SHOWING, estimators={"shower": "Shower"})


@pytest.fixture
def run_of(shower, tiny, tmp_path):
    """Run estimators on a small scenario, and return the folder."""

    def make(*estimators, scenarios=1):
        paths = [tiny]
        for number in range(1, scenarios):
            paths.append(tiny.with_name(f"tiny{number}.toml"))
            paths[-1].write_text(tiny.read_text().replace('"tiny"', f'"tiny{number}"'))
        suite = Suite(
            name="t", scenarios=list(map(str, paths)), estimators=estimators, snr_db=[0, 10], trials=2
        )
        run_suite(suite, tmp_path / "run")
        return tmp_path / "run"

    return make


@pytest.fixture
def quick_figures(monkeypatch):
    """Leave figures empty."""
    for module, name in itertools.product((figures, run_report, diagnoses), ("charts", "clouds", "map")):
        if hasattr(module, f"draw_{name}"):
            monkeypatch.setattr(module, f"draw_{name}", lambda *_: new_figure(1, 1))


def names_of(paths):
    return [path.name for path in paths]


def test_a_score_is_drawn_for_the_chosen_scenario_in_the_chosen_format(run_of):
    folder = run_of("blob", "seer", scenarios=2)
    paths = draw_chosen(Run.open(folder), FigureChoice(scenario="tiny1", metric="gospa_m"), "svg")
    assert names_of(paths) == ["gospa_m-tiny1.svg"]
    assert paths[0].read_text().startswith("<?xml")


def test_an_snr_and_a_trial_draw_clouds_maps_and_spectra(run_of, quick_figures):
    folder = run_of("blob", "shower")
    assert isinstance(get_estimator("shower"), Diagnoser)
    assert names_of(draw_chosen(Run.open(folder), FigureChoice(snr_db=10.0, trial=1))) == [
        "clouds-tiny-10dB-trial1.png",
        "rdm-tiny-shower-10dB-trial1.png",
        "spectrum-tiny-shower-10dB-trial1.png",
    ]
    assert names_of(draw_chosen(Run.open(folder), FigureChoice(scenario="tiny"))) == [
        "curves-tiny.png",
        "clouds-tiny-trial0.png",
    ]


def test_without_a_choice_all_figures_of_all_scenarios_are_drawn_in_the_format(run_of, quick_figures):
    folder = run_of("blob", scenarios=2)
    names = names_of(draw_chosen(Run.open(folder), FigureChoice(), "pdf"))
    assert names == [
        "deviation.pdf",
        "curves-tiny.pdf",
        "curves-tiny1.pdf",
        "radii.pdf",
        "clouds-tiny.pdf",
        "clouds-tiny1.pdf",
    ]
    names = names_of(draw_chosen(Run.open(folder), FigureChoice(metric="recall"), "pdf"))
    assert names == ["recall-tiny.pdf", "recall-tiny1.pdf"]


def test_a_diagnosis_that_fails_costs_its_own_figures_alone(run_of, quick_figures):
    folder = run_of("shower[fails=true]", "shower", "shower[detects=false]")
    with pytest.warns(InputWarning, match=r"shower\[fails=true\]: ZeroDivisionError: no luck"):
        names = names_of(draw_chosen(Run.open(folder), FigureChoice(snr_db=0.0)))
    assert [name for name in names if name.startswith(("rdm", "spectrum"))] == [
        "rdm-tiny-shower-0dB-trial0.png",
        "spectrum-tiny-shower-0dB-trial0.png",
        "rdm-tiny-shower-detects-false-0dB-trial0.png",
    ]


def test_of_very_many_estimators_the_best_show_their_work(run_of, quick_figures, monkeypatch):
    monkeypatch.setattr(clouds, "MOST_CLOUDS", 1)
    folder = run_of("blob", "shower[detects=false]", "shower")
    run = Run.open(folder)
    run.rows.loc[run.rows["params"].str.contains('"detects":true'), "deviation"] = 0.0
    names = names_of(draw_chosen(run, FigureChoice(trial=1)))
    assert [name for name in names if name.startswith("rdm")] == ["rdm-tiny-shower-10dB-trial1.png"]


def test_what_a_run_has_not_and_no_format_are_refused_with_what_is_allowed(run_of):
    folder = run_of("blob")
    for choice, message in (
        (FigureChoice(scenario="tyni"), "unknown scenario 'tyni': allowed are tiny"),
        (FigureChoice(snr_db=3.0), "no SNR in dB of 3; allowed are 0, 10"),
        (FigureChoice(trial=7), "no trial of 7; allowed are 0, 1"),
        (FigureChoice(metric="gopsa_m"), "did you mean 'gospa_m'"),
    ):
        with pytest.raises(InputError, match=message):
            draw_chosen(Run.open(folder), choice)
    with pytest.raises(InputError, match=r"\.png, \.pdf or \.svg"):
        draw_chosen(Run.open(folder), FigureChoice(metric="deviation"), "gif")
