"""Runs that pages are made of, made once a session, and a browser that opens pages."""

import os
import shutil
from contextlib import contextmanager
from pathlib import Path

import pytest

from isacbench.bench.kinds.detection import DetectionSuite
from isacbench.bench.kinds.link import LinkSuite
from isacbench.bench.run.runner import RunOptions, run_suite
from isacbench.bench.suites.suite import Suite
from isacbench.plugins.discovery import PluginFile, isolated_plugins, register_plugin

HOSTILE = """<script>alert('x')</script>"&amp;'{{content}} %{x} __proto__"""
"""Name of a scenario that a page could take for something else."""

YARD = """\
name = '''{name}'''
[system]
n_subcarriers = 256
n_symbols = 32
[array]
frame = "panel"
tx_shape = [1, 1]
rx_shape = [6, 6]
[base_station]
position_m = [5.0, 40.0, 10.0]
[region]
x_m = [0.0, 20.0]
y_m = [0.0, 10.0]
z_m = [0.0, 8.0]
speed_mps = [-15.0, 15.0]
[[objects]]
kind = "car"
position_m = [4.0, 5.0, 0.0]
velocity_mps = 10.0
[[objects]]
kind = "pole"
position_m = [{pole_m}, 5.0, 0.0]
velocity_mps = 0.0
"""

SHOWING = '''
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from isacbench.model.cloud import PointCloud
from isacbench.plugins.contracts import Detection, Diagnosis, Spectrum


@dataclass(frozen=True)
class Markup:
    """Goes wrong with a message that is markup."""

    name: ClassVar[str] = "markup"
    text: str = ""

    def estimate(self, observation):
        if self.text == "empty":
            return PointCloud.empty()
        raise ValueError("<img src=x onerror=alert(1)>" + self.text * 1000)


@dataclass(frozen=True)
class Showing:
    """Finds nothing, and shows what it is told to or fails to."""

    name: ClassVar[str] = "showing"
    deed: str = "infinity"

    def estimate(self, observation):
        return PointCloud.empty()

    def diagnose(self, observation):
        if self.deed == "raise":
            raise ZeroDivisionError("no luck")
        if self.deed == "none":
            return None
        gate = observation.gate
        power = np.mean(np.abs(observation.cells) ** 2, axis=(2, 3))
        threshold = np.full_like(power, np.inf)
        threshold[0, 0] = np.nan
        detection = Detection(power > 1e9, threshold, np.ones_like(power))
        cosine = np.linspace(-1, 1, 11)
        spectra = tuple(Spectrum(cosine, -(cosine**2), -0.5, np.zeros(1), label) for label in "uw")
        shown = (spectra, (int(gate.range_bins[5]), 0)) if self.deed == "spectra" else ((), None)
        found = Diagnosis(power, detection, gate.range_bins, gate.doppler_bins, *shown)
        malformed = {
            "map": {"power": power[1:]},
            "mask": {"detection": replace(detection, mask=detection.mask.T)},
            "complex": {"power": 1j * power},
            "bins": {"range_bins": "bins"},
            "empty": {"power": np.full_like(power, np.nan)},
            "texts": {"spectra": ("spectrum",), "cell": (0, 0)},
            "level": {"spectra": [replace(spectra[0], level_db=cosine[1:])], "cell": (0, 0)},
            "label": {"spectra": [replace(spectra[0], label=np)], "cell": (0, 0)},
            "cell": {"spectra": spectra, "cell": None},
        }
        return replace(found, **malformed.get(self.deed, {}))
'''

CHROMIUM = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
SOFTWARE_DRAWING = [
    *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-compositing"),
    "--no-sandbox",
]
NO_BROWSER = (
    "no Chromium: install Debian's package chromium, or name one in the environment variable CHROMIUM"
)


@pytest.fixture(scope="session")
def yard(tmp_path_factory):
    """Return a function that writes a small scenario of two objects, some metres apart, under a name."""

    def write(name, more_m=0):
        path = tmp_path_factory.mktemp("yard") / "yard.toml"
        path.write_text(YARD.format(name=name, pole_m=13.0 + more_m), encoding="utf-8")
        return str(path)

    return write


@contextmanager
def known():
    """Know the estimators markup and showing."""
    with isolated_plugins():
        register_plugin(PluginFile("showing.py", SHOWING))
        yield


@pytest.fixture
def showing():
    """Know these estimators in a test."""
    with known():
        yield


@pytest.fixture(scope="session")
def runs(yard, tmp_path_factory):
    """Folders of stored runs by name, each made at first use."""
    root = tmp_path_factory.mktemp("runs")
    common = {"name": "test", "scenarios": [yard("yard")], "estimators": ["fft4d", "oracle"]}
    hostile = ["markup[text=x]", "markup[text='<b>%{x}</b>\"']", "markup[text=empty]"]
    three = ["fft4d", "music2d", "oracle"]
    one = common | {"estimators": ["fft4d"]}
    suites = {
        "images": Suite(**common | {"estimators": three}, snr_db=[-10, 10], trials=10),
        "other": Suite(**common | {"estimators": ["esprit2d", "oracle"]}, snr_db=[-10, 10], trials=10),
        "hostile": Suite(
            **one | {"scenarios": [yard(HOSTILE)], "estimators": ["fft4d", *hostile]}, snr_db=[10], trials=1
        ),
        "scenes": Suite(
            **one | {"scenarios": [yard(f"yard{n}", n) for n in range(6)], "estimators": three},
            snr_db=[10],
            trials=1,
        ),
        "timed": Suite(**common, snr_db=[10], trials=6),
        "timed-once": Suite(**common, snr_db=[10], trials=1),
        "link": LinkSuite(**one, modulations=["qpsk", "16qam"], trials=1, channels=["awgn"], snr_db=[0, 10]),
        "detection": DetectionSuite(
            **one, detectors=["ca", "os"], maps=["homogeneous"], pfa=[1e-3, 1e-2], snr_gain_db=[20], trials=5
        ),
    }

    def make(name):
        folder = root / name
        if not folder.exists():
            with known():
                timing = {"timing": True, "repeats": 1} if "timed" in name else {}
                run_suite(suites[name], folder, options=RunOptions(**timing))
        return folder

    return make


@pytest.fixture(scope="module")
def browser():
    """Chromium without a window, driven by playwright."""
    playwright = pytest.importorskip("playwright.sync_api", reason="no playwright: pip install playwright")
    found = [os.environ.get("CHROMIUM", ""), *map(shutil.which, CHROMIUM)]
    executable = next((path for path in found if path and Path(path).exists()), None)
    if executable is None:
        pytest.skip(NO_BROWSER)
    with playwright.sync_playwright() as driver:
        one = driver.chromium.launch(executable_path=executable, args=SOFTWARE_DRAWING)
        yield one
        one.close()
