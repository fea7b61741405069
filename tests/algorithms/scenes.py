"""A few scatterers in front of a panel, of which the answer is known."""

from functools import cache

import numpy as np
import pytest
from isacbench_algorithms.chain import CellwiseEstimator

from isacbench.checking.stress import find_cases
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator
from isacbench.model.frame import PanelFrame, get_frame
from isacbench.model.numerology import System
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers, Scenario
from isacbench.plugins.registry import estimator_names, get_estimator

SYSTEM = System(n_subcarriers=256, n_symbols=64)
ARRAY = VirtualArray((2, 2), (4, 4), 4, 1)
BASE_M = np.array([15.0, 100.0, 20.0])
REGION = Region((0.0, 30.0), (0.0, 40.0), (0.0, 16.0), (-25.0, 25.0))
# Far enough apart in range that none lies in another's cell or next to it.
XYZ = np.array([[4.0, 6.0, 2.0], [25.0, 9.0, 12.0], [9.0, 18.0, 9.0], [21.0, 27.0, 4.0], [14.0, 36.0, 10.0]])
VELOCITY = np.array([0.0, 13.3, -8.1, 20.0, -17.7])
AMPLITUDE = np.array([1.0, 1.2, 0.8, 1.0, 1.0])
NOTHING = np.empty((0, 3))

BUILT_IN = [get_estimator(name) for name in estimator_names()]
CELLWISE = [type(estimator) for estimator in BUILT_IN if isinstance(estimator, CellwiseEstimator)]
"""Classes of all estimators that image cell by cell."""
EACH_CELLWISE = pytest.mark.parametrize("estimator", CELLWISE, ids=lambda one: one.name)


def simulator(xyz=XYZ, velocity=None, amplitude=None, *, array=ARRAY, frame="panel", region=REGION):
    """Simulator of as many of the five scatterers as there are places."""
    xyz = np.reshape(xyz, (-1, 3))
    velocity = VELOCITY[: len(xyz)] if velocity is None else np.array(velocity)
    amplitude = AMPLITUDE[: len(xyz)] if amplitude is None else np.array(amplitude)
    scatterers = Scatterers(xyz, velocity, amplitude)
    return Simulator(Scenario("few", SYSTEM, array, get_frame(frame), BASE_M, region, scatterers))


@cache
def echo_map(range_bin, doppler_bin, u, w, amplitude):
    """Noise-free map of scatterers given by tuples as the radio sees them."""
    xyz = BASE_M + PanelFrame().offsets(np.array(range_bin) * SYSTEM.range_bin_m, np.array(u), np.array(w))
    seen = simulator(xyz, np.array(doppler_bin) * SYSTEM.velocity_bin_mps, amplitude)
    return GatedMap(seen.clean, seen.gate)


def crowd(n):
    """Scenario of n scatterers of three speeds at random in front of an 8 x 8 array, many to a cell."""
    rng = np.random.default_rng(0)
    region = Region((0.0, 20.0), (0.0, 25.0), (0.0, 8.0), (-15.0, 15.0))
    xyz = region.lower_m + region.size_m * rng.random((n, 3))
    scatterers = Scatterers(xyz, rng.choice([-10.0, 0.0, 10.0], n), np.ones(n))
    system, base_m = System(n_subcarriers=256, n_symbols=56), np.array([10.0, 60.0, 15.0])
    return Scenario("crowd", system, ARRAY, get_frame("panel"), base_m, region, scatterers)


def distances_m(cloud, truth):
    """Distances (n_points, n_true) in m."""
    return np.linalg.norm(cloud.xyz[:, None] - truth.xyz, axis=2)


def stress_case(spec):
    """The one case of the stress test that a specification names."""
    (case,) = find_cases(spec)
    return case


EMPTY = Scenario(
    name="few",
    system=System(n_subcarriers=255, n_symbols=63),
    array=VirtualArray((1, 1), (8, 8), 1, 1),
    frame=get_frame("panel"),
    base_station_m=np.array([0.0, 110.0, 25.0]),
    region=Region((-60.0, 60.0), (-25.0, 45.0), (-25.0, 60.0), (-40.0, 40.0)),
    scatterers=Scatterers(NOTHING, np.empty(0), np.empty(0)),
)
"""Scenario without scatterers, with a region wide enough for any."""
