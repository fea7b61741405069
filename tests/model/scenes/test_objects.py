"""The objects of a street: their number of points, and the room they take."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.errors import InputError
from isacbench.model.scenes.objects import car, green_belt, lamp_post, pedestrian

SIZES = st.tuples(*[st.floats(0.5, 20)] * 3)


def box(points):
    """Corners of the bounding box."""
    return np.array([points.min(axis=0), points.max(axis=0)])


@pytest.mark.parametrize(
    ("outline", "n_points", "lower", "upper"),
    [
        (car, 114, [-1, -3, 0], [1, 3, 1.8]),
        (green_belt, 164, [-0.5, -10, 0], [0.5, 10, 1]),
        (lamp_post, 13, [-1, -1, 2], [1, 1, 10]),
        (pedestrian, 12, [-0.3, -0.35, 0], [0.3, 0.35, 1.8]),
    ],
)
def test_default_objects_have_the_points_and_the_room_of_the_street(outline, n_points, lower, upper):
    points = outline()
    assert points.shape == (n_points, 3)
    assert len(np.unique(points, axis=0)) == n_points
    assert (box(points) >= np.array(lower) - 0.06).all()
    assert (box(points) <= np.array(upper) + 0.06).all()
    assert box(points)[1, 2] == upper[2]


@given(SIZES)
def test_a_car_fills_exactly_its_size_and_is_symmetric_from_side_to_side(size_m):
    points, (width, length, height) = car(size_m), size_m
    expected = [[-width / 2, -length / 2, 0], [width / 2, length / 2, height]]
    np.testing.assert_allclose(box(points), expected, atol=1e-12)
    mirrored = points * [-1, 1, 1]
    np.testing.assert_allclose(points[np.lexsort(points.T)], mirrored[np.lexsort(mirrored.T)])


@given(SIZES, st.floats(0.1, 5))
def test_a_hedge_is_its_four_long_edges(size_m, spacing_m):
    width, length, height = size_m
    points = green_belt(size_m, spacing_m)
    edges = {(x, z) for x, z in points[:, [0, 2]].tolist()}
    assert edges == {(x, z) for x in (-width / 2, width / 2) for z in (0.0, height)}
    y = np.unique(points[:, 1])
    assert (y[0], y[-1]) == (-length / 2, length / 2)
    np.testing.assert_allclose(np.diff(y), length / (y.size - 1), rtol=1e-9)


def test_a_lamp_post_is_a_mast_with_four_arms_at_its_top():
    points = lamp_post(height_m=6.0, foot_m=1.0, spacing_m=0.5, arm_m=2.0)
    mast = points[(points[:, :2] == 0).all(axis=1)]
    assert mast[:, 2].tolist() == np.arange(1.0, 6.5, 0.5).tolist()
    arms = {tuple(point) for point in points[(points[:, :2] != 0).any(axis=1)].tolist()}
    assert arms == {(2, 0, 6), (-2, 0, 6), (0, 2, 6), (0, -2, 6)}
    with pytest.raises(InputError, match=r"foot_m = 2 must lie below height_m = 1\.5"):
        lamp_post(height_m=1.5)


@given(st.floats(0.5, 2.5))
def test_a_pedestrian_scales_with_its_height(height_m):
    np.testing.assert_allclose(pedestrian(height_m), pedestrian(1.0) * height_m)
