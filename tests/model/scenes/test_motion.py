"""Motion of objects: rigid bodies, limbs and wheels, projected on the line of sight."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from isacbench.model.scenes.objects import (
    approach_speeds,
    body_velocities,
    heading,
    limb_swing,
    pedestrian,
    turned,
    vehicle,
    wheel_roll,
)
from tests.conftest import refusal

ANGLES = st.floats(-720, 720)
STEP_S = 1e-6
BASE_STATION_M = np.array([20.0, 100.0, 20.0])


@given(ANGLES)
def test_a_heading_is_a_turn_of_the_front(yaw_deg):
    expected = [-np.sin(np.radians(yaw_deg)), np.cos(np.radians(yaw_deg)), 0]
    np.testing.assert_allclose(heading(yaw_deg), expected, atol=1e-12)


@given(ANGLES, st.integers(0, 99))
def test_turning_keeps_distances_and_heights(yaw_deg, seed):
    points = np.random.default_rng(seed).normal(size=(5, 3))
    moved = turned(points, yaw_deg)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), np.linalg.norm(points, axis=1), atol=1e-12)
    np.testing.assert_array_equal(moved[:, 2], points[:, 2])


@given(ANGLES, st.floats(-90, 90), st.integers(0, 99))
def test_the_approach_speed_is_what_the_distance_loses_as_the_body_moves(yaw_deg, yaw_rate_dps, seed):
    """Positions a moment before and after, by the closed form of a turning body."""
    random = np.random.default_rng(seed)
    outline, position, velocity = random.normal(size=(6, 3)), random.uniform(0, 30, 3), random.normal(size=3)

    def places(time_s):
        return position + velocity * time_s + turned(outline, yaw_deg + yaw_rate_dps * time_s)

    distances = [np.linalg.norm(places(time_s) - BASE_STATION_M, axis=1) for time_s in (-STEP_S, STEP_S)]
    expected = (distances[0] - distances[1]) / (2 * STEP_S)
    offsets = turned(outline, yaw_deg)
    velocities = body_velocities(offsets, velocity.tolist(), yaw_rate_dps, np.zeros_like(offsets))
    speeds = approach_speeds(position + offsets, velocities, BASE_STATION_M)
    np.testing.assert_allclose(speeds, expected, atol=1e-7)


@given(st.floats(0, 360))
def test_limbs_swing_as_their_places_change_with_the_stride(phase_deg):
    """The frequency follows from the standing foot, whose amplitude is 0.19 of the height."""
    height_m, speed_mps = 1.8, 1.5
    turn_dps = np.degrees(speed_mps / (0.19 * height_m))
    before, after = (pedestrian(height_m, phase_deg + turn_dps * time_s) for time_s in (-STEP_S, STEP_S))
    np.testing.assert_allclose(speed_mps * limb_swing(phase_deg), (after - before) / (2 * STEP_S), atol=1e-6)


def test_the_foot_that_passes_backwards_stands_on_the_ground():
    feet = limb_swing(90.0)[[5, 11], 1]
    np.testing.assert_allclose(feet, [-1.0, 1.0])


def test_a_wheel_rolls():
    """The lowest point stands, the highest has twice the speed, the hub's height that of the vehicle."""
    rims, roll = vehicle()[-16:], wheel_roll(4)
    total = roll + np.array([0.0, 1.0, 0.0])
    np.testing.assert_array_equal(np.linalg.norm(total[rims[:, 2] == rims[:, 2].min()], axis=1), 0)
    np.testing.assert_array_equal(total[rims[:, 2] == rims[:, 2].max()], [[0, 2, 0]] * 4)
    np.testing.assert_allclose(np.linalg.norm(roll, axis=1), 1)


POLE = '[[objects]]\nkind = "pole"\nposition_m = [20.0, 10.0, 0.0]\n'


def test_a_number_is_a_radial_speed_and_a_vector_is_projected(load_objects):
    radial = load_objects(f"{POLE}velocity_mps = 3.0").scatterers
    np.testing.assert_array_equal(radial.velocity, 3.0)
    vector = load_objects(f"{POLE}velocity_mps = [0.0, 3.0, 0.0]").scatterers
    sight = vector.xyz - BASE_STATION_M
    np.testing.assert_allclose(vector.velocity, 270 / np.linalg.norm(sight, axis=1), atol=1e-6)


def test_a_wrong_motion_is_refused_in_one_line(load_objects):
    for value in ("[1.0, 2.0]", '"3"', "true", "[nan, 0.0, 0.0]"):
        message = refusal(load_objects, f"{POLE}velocity_mps = {value}")
        assert "allowed is a radial speed" in message
    message = refusal(load_objects, f"{POLE}velocity_mps = 1.0\nyaw_rate_dps = 5.0")
    assert "yaw_rate_dps needs velocity_mps as a vector" in message
    assert "yaw_deg" in refusal(load_objects, f"{POLE}yaw_deg = inf")
