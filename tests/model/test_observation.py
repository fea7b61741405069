"""Observations: read-only, and the one step from detections to points."""

import dataclasses

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from isacbench.model.echo import observe_echo
from isacbench.model.frame import PanelFrame, PaperFrame
from isacbench.model.region import Region

PLACES, SPEEDS = st.tuples(st.floats(0, 10), st.floats(0, 10), st.floats(0, 5)), st.floats(-15, 15)


@pytest.fixture(scope="module", params=["panel", "paper"])
def observation(request, make_scenario):
    """One observation in each frame."""
    return observe_echo(make_scenario(request.param), snr_db=10)


def detections(observation, xyz, speed_mps):
    """Bins and direction cosines that points stand for."""
    offset_m = np.asarray(xyz) - observation.base_station_m
    range_bin = np.linalg.norm(offset_m, axis=1) / observation.system.range_bin_m
    doppler_bin = np.asarray(speed_mps) / observation.system.velocity_bin_mps
    return range_bin, doppler_bin, *observation.frame.direction_cosines(offset_m)


def test_arrays_cannot_be_written_to(observation):
    gate = observation.gate
    for array in (observation.cells, observation.base_station_m, gate.range_bins, gate.doppler_bins):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_cells_are_those_of_the_gate_on_every_element(observation):
    assert observation.cells.shape == (*observation.gate.shape, *observation.array.shape)
    assert observation.cells.dtype == np.complex128


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


@given(PLACES)
def test_the_cosine_limits_hold_every_point_of_the_region(observation, place):
    _, _, u, w = detections(observation, [place], [0.0])
    (u_low, u_high), (w_low, w_high) = observation.cosine_limits
    assert u_low - 1e-3 <= u[0] <= u_high + 1e-3
    assert w_low - 1e-3 <= w[0] <= w_high + 1e-3


@given(place=PLACES, speed_mps=SPEEDS, range_turns=st.integers(-3, 3), doppler_turns=st.integers(-3, 3))
@example((1.0, 2.0, 3.0), 7.0, 0, 0)
def test_exact_detections_become_the_points_they_came_from_whole_transforms_away_too(
    observation, place, speed_mps, range_turns, doppler_turns
):
    range_bin, doppler_bin, u, w = detections(observation, [place], [speed_mps])
    range_bin += range_turns * observation.system.n_subcarriers
    doppler_bin += doppler_turns * observation.system.n_symbols
    cloud = observation.cloud(range_bin, doppler_bin, u, w, [2.5])
    np.testing.assert_allclose(cloud.xyz, [place], atol=1e-9)
    assert cloud.velocity[0] == pytest.approx(speed_mps, abs=1e-9)
    assert cloud.power.tolist() == [2.5]


def test_a_speed_next_to_the_unambiguous_one_is_the_one_that_the_region_allows(observation):
    system = observation.system
    half, bin_mps = system.n_symbols / 2, system.velocity_bin_mps
    region = dataclasses.replace(observation.region, speed_mps=(20 * bin_mps / 2, half * bin_mps))
    fast = dataclasses.replace(observation, region=region)
    range_bin, _, u, w = detections(observation, [[5.0, 5.0, 1.0]], [0.0])
    cloud = fast.cloud(range_bin, [-half - 0.3], u, w, [1.0])
    assert cloud.velocity[0] == pytest.approx((half - 0.3) * bin_mps)


@pytest.mark.parametrize(("range_bin", "n_points"), [(0.4, 1), (-0.4, 1), (-0.6, 0), (-1.0, 0)])
def test_no_point_lies_behind_the_array(observation, range_bin, n_points):
    around = Region((-50.0, 60.0), (0.0, 80.0), (-50.0, 60.0), (-1.0, 1.0))
    seen = dataclasses.replace(observation, region=around)
    cloud = seen.cloud([range_bin], [0.0], [0.3], [0.2], [1.0])
    assert len(cloud) == n_points
    distance_m = np.linalg.norm(cloud.xyz - seen.base_station_m, axis=1)
    np.testing.assert_allclose(distance_m, max(range_bin, 0) * seen.system.range_bin_m, atol=1e-12)


@pytest.mark.parametrize("frame", [PanelFrame(), PanelFrame(0, 90), PanelFrame(30, 20), PaperFrame()])
@pytest.mark.parametrize(("base_m", "y_m"), [([0, 0, 15], (-300.0, 300.0)), ([3, 7, 4], (-300.0, 20.0))])
def test_the_cosine_limits_hold_a_region_right_below_the_base_station_or_around_it(
    observation, frame, base_m, y_m
):
    region = Region((-300.0, 300.0), y_m, (0.0, 5.0), (0.0, 1.0))
    base_m = np.array(base_m, dtype=float)
    seen = dataclasses.replace(observation, frame=frame, base_station_m=base_m, region=region)
    (u_low, u_high), (w_low, w_high) = seen.cosine_limits
    rng = np.random.default_rng(2)
    near_m = base_m + rng.normal(size=(20000, 3)) * 10 ** rng.uniform(-2, 2.5, (20000, 1))
    offset_m = np.clip(near_m, region.lower_m, region.upper_m) - base_m
    u, w = frame.direction_cosines(offset_m[frame.in_half_space(offset_m)])
    assert u_low - 2e-3 <= u.min() <= u.max() <= u_high + 2e-3
    assert w_low - 2e-3 <= w.min() <= w.max() <= w_high + 2e-3
