"""Echoes near the ends of the circle of direction cosines are found as well on one side as on the other."""

from dataclasses import replace

import numpy as np
import pytest

from isacbench.checking.scenes import Echo, Layout, observed
from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator
from isacbench.model.scene import Scatterers
from isacbench.plugins.registry import build_estimator, estimator_names, sees_truth
from tests.algorithms.scenes import EMPTY
from tests.conftest import slow_but

ESTIMATORS = sorted(name for name in estimator_names() if not sees_truth(name))
RANGE_M = 40.0


@pytest.mark.parametrize("shape", slow_but(["8x8"], ["4x4", "4x8", "5x7", "8x4", "8x8", "16x16"]))
@pytest.mark.parametrize("axis", ["azimuth", "elevation"])
@pytest.mark.parametrize("name", [*ESTIMATORS, "music2d[search=root]"])
def test_one_echo_is_one_point_up_to_89_degrees_on_either_side(name, axis, shape):
    estimator = build_estimator(name)
    for angle in np.radians([79.0, 85.0, 89.0]):
        for side in (-1, 1):
            aside, ahead = side * RANGE_M * np.sin(angle), RANGE_M * np.cos(angle)
            offset = (aside, -ahead, 0.0) if axis == "azimuth" else (0.0, -ahead, aside)
            place = EMPTY.base_station_m + offset
            echo = Scatterers(place[None], np.array([7.3]), np.ones(1))
            array = VirtualArray((1, 1), tuple(map(int, shape.split("x"))), 1, 1)
            region = replace(EMPTY.region, y_m=(60.0, 110.0), z_m=(-25.0, 75.0))
            seen = Simulator(replace(EMPTY, scatterers=echo, array=array, region=region)).observe(20.0)
            found = estimator.estimate(seen).xyz
            assert np.linalg.norm(found - place, axis=1) == pytest.approx([0.0], abs=1.0), (angle, side)


@pytest.mark.parametrize("shape", [(8, 4), (4, 8), (2, 14), (16, 2), (6, 6)])
def test_fft4d_images_a_lone_echo_between_samples_on_few_elements(shape):
    estimator = build_estimator("fft4d")
    rng = np.random.default_rng(3)
    for u in rng.uniform(-0.98, 0.98, 12):
        echo = Echo(9.3, 1.2, u, rng.uniform(-0.9, 0.9) * np.sqrt(1 - u * u))
        for snr_db in (np.inf, 20.0):
            assert len(estimator.estimate(observed([echo], snr_db, layout=Layout(array=shape)).seen)) == 1
