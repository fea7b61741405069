"""Observations: read-only, and the one step from detections to points."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.model.echo import observe

FRAMES = ["panel", "paper"]


@pytest.fixture(scope="module", params=FRAMES)
def observation(request, make_scenario):
    """One observation in each frame."""
    return observe(make_scenario(request.param), snr_db=10)


def detections(observation, xyz, speed_mps):
    """Bins and direction cosines that points stand for."""
    offset_m = np.asarray(xyz) - observation.base_station_m
    range_bin = np.linalg.norm(offset_m, axis=1) / observation.system.range_bin_m
    return (
        range_bin,
        np.asarray(speed_mps) / observation.system.velocity_bin_mps,
        *observation.frame.direction_cosines(offset_m),
    )


def test_arrays_cannot_be_written_to(observation):
    gate = observation.gate
    for array in (observation.cells, observation.base_station_m, gate.range_bins, gate.doppler_bins):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_cells_are_those_of_the_gate_on_every_element(observation):
    assert observation.cells.shape == (*observation.gate.shape, *observation.array.shape)
    assert observation.cells.dtype == np.complex128


@given(st.tuples(st.floats(0, 10), st.floats(0, 10), st.floats(0, 5)), st.floats(-15, 15))
def test_exact_detections_become_the_points_they_came_from(observation, place, speed_mps):
    cloud = observation.cloud(*detections(observation, [place], [speed_mps]), power=[2.5])
    np.testing.assert_allclose(cloud.xyz, [place], atol=1e-9)
    assert cloud.velocity[0] == pytest.approx(speed_mps)
    assert cloud.power.tolist() == [2.5]


def test_points_more_than_half_a_metre_outside_the_region_are_dropped(observation):
    xyz = [[10.49, 5.0, 1.0], [10.51, 5.0, 1.0], [5.0, -0.49, 1.0], [5.0, 5.0, 5.51], [5.0, 5.0, -0.49]]
    cloud = observation.cloud(*detections(observation, xyz, np.zeros(5)), power=np.arange(5.0))
    assert cloud.power.tolist() == [0.0, 2.0, 4.0]


def test_directions_outside_the_visible_region_are_dropped_not_clipped(observation):
    range_bin, doppler_bin, u, w = detections(observation, [[5.0, 5.0, 1.0]] * 3, np.zeros(3))
    cloud = observation.cloud(range_bin, doppler_bin, [u[0], 1.01, 0.8], [w[0], 0.0, 0.8], [1.0, 2.0, 3.0])
    assert cloud.power.tolist() == [1.0]


def test_no_detections_make_an_empty_cloud(observation):
    assert len(observation.cloud([], [], [], [], [])) == 0


@given(st.tuples(st.floats(0, 10), st.floats(0, 10), st.floats(0, 5)))
def test_the_cosine_limits_hold_every_point_of_the_region(observation, place):
    _, _, u, w = detections(observation, [place], [0.0])
    (u_low, u_high), (w_low, w_high) = observation.cosine_limits
    assert u_low - 1e-3 <= u[0] <= u_high + 1e-3
    assert w_low - 1e-3 <= w[0] <= w_high + 1e-3
