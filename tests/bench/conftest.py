"""A room with space for one scatterer or two, images made up for it, and plugins that go wrong."""

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest

from isacbench.bench.cells.images import Image
from isacbench.bench.run.runner import run
from isacbench.bench.suites.suite import Suite
from isacbench.model.cloud import PointCloud
from isacbench.model.radio_coordinates import space_places
from isacbench.model.scene import Scatterers
from isacbench.model.scenes.scenario import load_scenario
from isacbench.plugins.discovery import load_plugin_file
from tests.conftest import ROOM


@pytest.fixture(scope="session")
def room(tmp_path_factory):
    """Return a scenario without scatterers; odd sizes put one element at the centre of the aperture."""
    path = tmp_path_factory.mktemp("room") / "room.toml"
    path.write_text(ROOM)
    return load_scenario(path)


@pytest.fixture(scope="session")
def shoot():
    """Return a function that pairs a scenario with an image: points given as the radio sees them."""

    def make(scenario, places, snr_db=0.0):
        xyz, velocity = space_places(scenario, np.reshape(places, (-1, 4)))
        cloud = PointCloud(xyz, velocity, np.ones(len(velocity)))
        return Image(scenario, observation=None, estimator=None, snr_db=snr_db, cloud=cloud)

    return make


@pytest.fixture(scope="session")
def put():
    """Return a function that puts unit scatterers into a scenario, at places as the radio sees them."""

    def make(scenario, places):
        xyz, velocity = space_places(scenario, np.reshape(places, (-1, 4)))
        return dataclasses.replace(scenario, scatterers=Scatterers(xyz, velocity, np.ones(len(velocity))))

    return make


@pytest.fixture
def wreck(write_plugin):
    """Register a plugin file that does right, as `good` and `dice`, and wrong in many ways, as `wreck`."""
    path = write_plugin("wreck.py", Path(__file__).with_name("wreck.py").read_text())
    load_plugin_file(path)
    return path


@pytest.fixture
def suite(plugins, tiny):
    """Return a suite of twelve cells of two estimators; tests of other runs have suites of their own."""
    return Suite(
        name="test", scenarios=[str(tiny)], estimators=["blob", "seer"], snr_db=[-10, 0], trials=3, seed=1
    )


@pytest.fixture(scope="module")
def shelf(tmp_path_factory):
    """Return a folder for runs that several tests of a module begin with or read."""
    return tmp_path_factory.mktemp("shelf")


@pytest.fixture(scope="module")
def remembered():
    """Return a place for what several tests of a module read: the first that asks makes it."""
    return {}


@pytest.fixture
def records(suite, remembered):
    """Rows of a run of the module's suite."""
    if "records" not in remembered:
        remembered["records"] = run(suite)
    return remembered["records"].copy()


@pytest.fixture
def run_once(shelf, tmp_path):
    """Return a function that makes a run of a suite, once in a module, and returns the folder of a copy."""

    def copied(name, suite, **options):
        if not (shelf / name).exists():
            run(suite, out=shelf / name, **options)
        return shutil.copytree(shelf / name, tmp_path / name)

    return copied


class Clock:
    """A clock whose time passes when a test says so."""

    time_s = 0.0

    def __call__(self):
        return self.time_s


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture(scope="session")
def of_summary():
    """Return a function that makes a kind whose rows are their own summary."""

    def make(kind):
        return type(kind.__name__, (kind,), {"summary": lambda self, rows: rows})()

    return make
