"""Doppler lines of a cell, read apart: each gets its own directions, and nothing else changes."""

import numpy as np
import pytest
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.music2d import Music2d

from isacbench.added_fields import identity_fields
from isacbench.model.echo import Simulator
from isacbench.model.frame import get_frame
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers, Scenario
from tests.algorithms.scenes import ARRAY, BASE_M, SYSTEM

BOTH = pytest.mark.parametrize("estimator", [Music2d, Fft4d], ids=lambda e: e.name)
OBJECTS_U = (-0.015, 0.015)
SPEED_BINS = (2.0, 2.45)


@pytest.fixture
def side_by_side():
    """Two objects of eight range bins, an eighth of a Rayleigh cell and half a Doppler bin apart."""
    frame, first_bin = get_frame("panel"), np.ceil(80 / SYSTEM.range_bin_m)
    range_m = (first_bin + np.tile(np.arange(0, 16, 2), 2) + 0.2) * SYSTEM.range_bin_m
    xyz = BASE_M + frame.offsets(range_m, np.repeat(OBJECTS_U, 8), np.full(16, -0.1))
    velocity = np.repeat(SPEED_BINS, 8) * SYSTEM.velocity_bin_mps
    return observed(xyz, velocity)


def observed(xyz, velocity):
    """Scatterers of a scene in front of an 8 x 8 array, and an observation of them at 20 dB."""
    scatterers = Scatterers(xyz, velocity, np.ones(len(xyz)))
    sides = zip(xyz.min(axis=0) - 3, xyz.max(axis=0) + 3, strict=True)
    region = Region(*((float(lower), float(upper)) for lower, upper in sides), (-25.0, 25.0))
    scenario = Scenario("lines", SYSTEM, ARRAY, get_frame("panel"), BASE_M, region, scatterers)
    return scatterers, Simulator(scenario).observe(20.0)


@BOTH
def test_speeds_half_a_bin_apart_each_get_their_own_directions(estimator, side_by_side):
    truth, observation = side_by_side

    def n_found(cloud):
        offset_m = np.linalg.norm(truth.xyz[:, None] - cloud.xyz, axis=2)
        off_mps = np.abs(truth.velocity[:, None] - cloud.velocity)
        near = (offset_m < 0.5) & (off_mps < 0.1 * SYSTEM.velocity_bin_mps)
        return np.count_nonzero(near.any(axis=1))

    # Far below the strongest cells there are some that hold one speed alone.
    methods = (estimator(demix=demix, dynamic_range_db=28.0) for demix in (True, False))
    apart, mixed = (n_found(method.estimate(observation)) for method in methods)
    assert apart == 16
    assert mixed == 0


@BOTH
def test_a_single_speed_is_read_as_it_is(estimator):
    xyz = np.array([[4.0, 6.0, 2.0], [25.0, 9.0, 12.0], [9.0, 18.0, 9.0]])
    observation = observed(xyz, np.full(3, 3.1))[1]
    clouds = [estimator(demix=demix).estimate(observation).to_array() for demix in (True, False)]
    np.testing.assert_allclose(*clouds, rtol=1e-12)


@BOTH
def test_without_demixing_and_with_any_far_range_it_is_the_estimator_of_older_rows(estimator):
    older = identity_fields(estimator(demix=False, far_dynamic_range_db=None))
    assert not {"demix", "far_dynamic_range_db"} & older.keys()
    assert identity_fields(estimator()) == {**older, "demix": True, "far_dynamic_range_db": 16.0}
