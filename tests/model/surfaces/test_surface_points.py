"""Points on triangles: where they lie, how far apart, and which surfaces have any."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from trimesh.triangles import closest_point

from isacbench.model.scenes.objects import turned
from isacbench.model.scenes.solids import cuboid, globe, tube
from isacbench.model.surfaces import surface_points as sampling
from isacbench.model.surfaces.surface_points import clipped, surface_points
from tests.conftest import refusal

SIZES, SEEDS = st.tuples(*[st.floats(0.6, 9)] * 3), st.integers(0, 2**32)


def spread(points):
    """Distances of the points to their nearest neighbours."""
    return cKDTree(points).query(points, 2)[0][:, 1]


def tilted(triangles, yaw_deg):
    """Triangles of the xy plane, turned up and about the vertical."""
    return turned(triangles.reshape(-1, 3)[:, [2, 0, 1]], yaw_deg)[:, [1, 2, 0]].reshape(-1, 3, 3)


def rectangle(width, height):
    corners = np.array([[0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0]], dtype=float)
    return corners[[[0, 1, 2], [0, 2, 3]]]


def off_surface(points, triangles):
    """Distance of each point to the nearest triangle."""
    pairs = closest_point(np.tile(triangles, (len(points), 1, 1)), np.repeat(points, len(triangles), axis=0))
    distance = np.linalg.norm(pairs.reshape(len(points), -1, 3) - points[:, None], axis=2)
    return distance.min(axis=1)


@given(SIZES)
def test_a_box_has_a_point_for_each_square_of_the_spacing_in_equal_steps_within_a_third(size_m):
    points = surface_points(cuboid([0, 0, 0], size_m), 0.5)
    a, b, c = np.maximum(1, np.round(np.array(size_m) / 0.5))
    assert len(points) == 2 * (a * b + b * c + c * a)
    roof = points[points[:, 2] > size_m[2] - 1e-9]
    for axis in (0, 1):
        steps = np.diff(np.unique(roof[:, axis].round(9)))
        if steps.size:
            np.testing.assert_allclose(steps, steps[0], rtol=1e-6)
            assert 0.5 / 1.5 < steps[0] < 0.5 * 1.5


@given(SEEDS, st.floats(0.2, 1.0))
def test_points_lie_on_the_triangles(seed, spacing_m):
    triangles = np.random.default_rng(seed).normal(scale=2, size=(5, 3, 3))
    points = surface_points(triangles, spacing_m)
    assert len(points)
    assert off_surface(points, triangles).max() < 1e-9


@given(SEEDS)
def test_no_place_of_a_surface_is_far_from_a_point(seed):
    random = np.random.default_rng(seed)
    triangles = random.normal(scale=3, size=(4, 3, 3))
    points = surface_points(triangles, 0.5)
    shares = random.dirichlet(np.ones(3), (4, 200))
    places = np.einsum("tsc,tcd->tsd", shares, triangles).reshape(-1, 3)
    # The diagonal of the largest cell, 1.3 m, less what its own point saves.
    assert cKDTree(points).query(places)[0].max() < 1.2


@pytest.mark.parametrize("spacing_m", [0.3, 0.5, 1.0])
def test_a_turned_plane_has_points_about_a_spacing_apart(spacing_m):
    points = surface_points(tilted(rectangle(20, 20), 33.0), spacing_m)
    distance = spread(points)
    assert distance.min() >= 0.6 * spacing_m - 1e-9
    assert 0.7 < np.median(distance) / spacing_m < 1.1
    assert 0.8 < len(points) / (400 / spacing_m**2) < 1.6


def test_both_sides_of_a_thin_wall_have_points():
    points = surface_points(cuboid([0, 0, 0], [0.05, 8.0, 4.0]), 0.5)
    assert (points[:, 0] < 1e-9).sum() == (points[:, 0] > 0.05 - 1e-9).sum() == 16 * 8


def test_a_sheet_that_is_drawn_from_both_sides_has_its_points_once():
    sheet = rectangle(6, 3)
    assert len(surface_points(sheet, 0.5)) == 12 * 6
    for yaw_deg in (0.0, 20.0, 45.0):
        one = tilted(sheet, yaw_deg)
        both = np.concatenate([one, one[:, ::-1]])
        assert len(surface_points(both, 0.5)) == len(surface_points(one, 0.5))


def test_a_sheet_no_thicker_than_what_visibility_tells_apart_has_its_points_once():
    points = surface_points(cuboid([0, 0, 0], [10.0, 0.015, 5.0]), 0.5)
    # The rim has points of its own.
    assert len(points) <= 20 * 10 + 2 * (20 + 10)


def test_surfaces_without_a_finite_size_are_refused():
    for size_m in (1e80, np.inf, np.nan):
        assert "finite coordinates in m" in refusal(surface_points, np.full((1, 3, 3), size_m), 0.5)
    assert len(surface_points(cuboid([0, 0, 0], [1, 1, 1]), 1e200)) == 6


def test_thin_parts_that_ask_for_too_many_places_are_refused():
    message = refusal(surface_points, tube([0, 0, 0], [0, 0, 10], 1e-7), 1e-5)
    assert "places on its surface; allowed are at most 20000000" in message


def test_thin_poles_have_points_all_the_way_up():
    points = surface_points(tube([3.1, 2.2, 0.0], [3.1, 2.2, 6.0], 0.05), 0.5)
    assert np.diff(np.unique(points[:, 2].round(6))).max() < 0.6
    assert spread(points).min() > 0.05


def test_the_order_of_the_triangles_does_not_matter():
    triangles = globe([1.0, 2.0, 3.0], [2.0, 3.0, 1.0])
    points = surface_points(triangles, 0.5)
    shuffled = surface_points(np.random.default_rng(1).permutation(triangles), 0.5)
    assert len(points) == len(shuffled)
    assert cKDTree(points).query(shuffled)[0].max() < 0.3


def test_triangles_without_area_have_no_points():
    assert surface_points(np.zeros((3, 3, 3)), 0.5).shape == (0, 3)


def test_too_many_points_are_refused_with_a_spacing_that_fits(monkeypatch):
    message = refusal(surface_points, cuboid([0, 0, 0], [300.0, 300.0, 10.0]), 0.5)
    assert "1.92e+05 m²" in message
    assert "allowed are at most 200000, a spacing_m of 0.98" in message
    monkeypatch.setattr(sampling, "MOST_SURFACE_POINTS", 20_000)
    triangles = cuboid([0, 0, 0], [95.0, 95.0, 3.0])
    assert "allowed are at most 20000, a spacing_m of 0.98" in refusal(surface_points, triangles, 0.5)
    assert len(surface_points(triangles, 0.98)) <= 20_000


@given(st.tuples(*[st.integers(-30, 30)] * 3), SIZES)
def test_clipping_leaves_the_area_that_lies_in_the_box(corner, size_m):
    lower, upper = np.zeros(3), np.full(3, 2.0)
    low = np.array(corner) / 10
    high = low + size_m
    within = clipped(cuboid(low, high), lower, upper)
    assert (within >= lower - 2e-6).all()
    assert (within <= upper + 2e-6).all()
    area = np.linalg.norm(np.cross(*np.diff(within, axis=1).swapaxes(0, 1)), axis=1).sum() / 2
    sides = (np.minimum(high, upper) - np.maximum(low, lower)).clip(0)
    expected = 0.0
    for axis in range(3):
        others = np.delete(sides, axis)
        expected += others.prod() * sum(0 <= level <= 2 for level in (low[axis], high[axis]))
    assert area == pytest.approx(expected, abs=1e-3)


def test_what_lies_in_the_box_is_not_touched():
    box = cuboid([0, 0, 0], [1, 2, 3])
    assert clipped(box, np.zeros(3), np.array([1.0, 2.0, 3.0])) is box
