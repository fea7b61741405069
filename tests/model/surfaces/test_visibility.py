"""Visibility: rays against plain double loops, closed-form shadows, and grazing cases."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.model.scenes.solids import cuboid, globe
from isacbench.model.surfaces.surface_points import NO_PART, TOLERANCE_M, seen_points
from tests.conftest import few

SEEDS = st.integers(0, 2**32)
BASE_M = np.array([20.0, 100.0, 20.0])
WALL = np.array([[[0, 10, 0], [40, 10, 0], [40, 10, 6]], [[0, 10, 0], [40, 10, 6], [0, 10, 6]]], dtype=float)


def seen(xyz, triangles, base_m=BASE_M):
    """Points that only surfaces hide, each triangle of a part of its own."""
    xyz = np.atleast_2d(np.asarray(xyz, dtype=float))
    return seen_points(base_m, xyz, np.full(len(xyz), NO_PART), triangles, np.arange(len(triangles)))


def drawn_triangles(random, n, spread=3):
    """Small triangles within 30 m."""
    return random.uniform(0, 30, (n, 1, 3)) + random.normal(scale=spread, size=(n, 3, 3))


def seen_one_by_one(base_m, points, triangles):
    """Plain double loop: a triangle hides a point if the ray crosses it more than the tolerance before."""
    found = []
    for point in points:
        length = np.linalg.norm(point - base_m)
        is_hidden = False
        for a, b, c in triangles:
            system = np.column_stack([b - a, c - a, base_m - point])
            if abs(np.linalg.det(system)) < 1e-9:
                continue
            first, second, back = np.linalg.solve(system, base_m - a)
            inside = first >= 0 and second >= 0 and first + second <= 1
            is_hidden |= bool(inside and 0 < back * length < length - TOLERANCE_M)
        found.append(not is_hidden)
    return np.array(found)


@given(SEEDS)
def test_batched_rays_find_what_a_double_loop_over_rays_and_triangles_finds(seed):
    random = np.random.default_rng(seed)
    triangles, points = drawn_triangles(random, 15), random.uniform([0, 0, 0], [40, 30, 15], (25, 3))
    np.testing.assert_array_equal(seen(points, triangles), seen_one_by_one(BASE_M, points, triangles))


@given(st.floats(0, 9.5), st.floats(0, 9), st.floats(1, 39))
def test_a_wall_casts_the_shadow_of_similar_triangles(y, z, x):
    """The sight line over the wall's upper edge falls by the base station's height over the edge."""
    shadow_m = 20 - (20 - 6) * (100 - y) / (100 - 10)
    if abs(z - shadow_m) > 1e-6:
        assert seen([20 + (x - 20) * 0.9, y, z], WALL).item() == (z > shadow_m)


@given(st.tuples(*[st.floats(0.5, 10)] * 3), st.integers(0, 99))
def test_of_a_box_the_faces_that_look_at_the_base_station_are_seen(size_m, seed):
    random = np.random.default_rng(seed)
    lower = random.uniform([0, 0, 0], [30, 30, 10])
    triangles = cuboid(lower, lower + size_m)
    for axis in range(3):
        for level in (lower[axis], lower[axis] + size_m[axis]):
            place = lower + np.array(size_m) * random.uniform(0.2, 0.8, 3)
            place[axis] = level
            outwards = np.sign(level - lower[axis] - size_m[axis] / 2)
            # At a grazing angle the tolerance decides.
            towards = (BASE_M - place)[axis] * outwards / np.linalg.norm(BASE_M - place)
            if abs(towards) > 0.05:
                assert seen(place, triangles).item() == (towards > 0)


def test_of_a_ball_the_half_towards_the_base_station_is_seen():
    centre = np.array([20.0, 10.0, 5.0])
    triangles = globe(centre, [3.0, 3.0, 3.0])
    middles = triangles.mean(axis=1)
    cosine = np.einsum("ij,ij->i", middles - centre, BASE_M - middles)
    cosine /= np.linalg.norm(middles - centre, axis=1) * np.linalg.norm(BASE_M - middles, axis=1)
    is_seen = seen(middles, triangles)
    assert is_seen[cosine > 0.15].all()
    assert not is_seen[cosine < -0.15].any()


@pytest.mark.parametrize("share", [0.25, 0.5, 0.75])
def test_no_ray_leaks_through_the_edge_between_two_triangles(share):
    """On the diagonal, where the two triangles of the wall meet."""
    on_diagonal = np.array([40 * share, 10, 6 * share])
    behind = on_diagonal + 0.1 * (on_diagonal - BASE_M)
    for shift_m in (0.0, 1e-5 * (share - 0.5)):
        assert not seen(behind, WALL + np.array([0.0, 0.0, shift_m])).any()


@pytest.mark.parametrize("distance_m", [1e-9, 0.01, 0.019])
def test_a_surface_does_not_hide_the_points_on_it(distance_m):
    """Sampled points are on their surface up to rounding; the tolerance is 2 cm."""
    on_wall = np.array([[10.0, 10.0, 3.0], [20.0, 10.0, 0.0], [30.0, 10.0, 6.0]])
    sight = (on_wall - BASE_M) / np.linalg.norm(on_wall - BASE_M, axis=1, keepdims=True)
    assert seen(on_wall + distance_m * sight, WALL).all()


def test_a_part_hides_all_points_but_its_own():
    points = np.array([[20.0, 9.0, 1.0], [21.0, 9.0, 1.0]])
    is_seen = seen_points(BASE_M, points, np.array([7, 8]), WALL, np.array([7, 7]))
    assert is_seen.tolist() == [True, False]


def test_behind_its_own_part_another_one_hides_a_point():
    """The ray meets the point's own part first, then the wall, then the point."""
    own = WALL + np.array([0.0, 10.0, 0.0])
    triangles, parts = np.concatenate([own, WALL]), np.array([3, 3, 4, 4])
    point = np.array([[20.0, 9.0, 1.0]])
    assert seen_points(BASE_M, point, np.array([3]), triangles, parts).tolist() == [False]
    assert seen_points(BASE_M, point, np.array([3]), own, parts[:2]).tolist() == [True]


@pytest.mark.parametrize("above_m", [0.0, 1e-9, 1e-3])
def test_a_base_station_on_a_roof_does_not_see_through_the_house(above_m):
    house = np.concatenate([cuboid([0, 95, 0], [40, 110, 20]), cuboid([0, 20, 0], [40, 22, 15])])
    base_m = np.array([20.0, 100.0, 20.0 + above_m])
    assert not seen([[20.0, 10.0, 1.0], [20.0, 21.0, 15.0]], house, base_m).any()
    assert seen([20.0, 90.0, 30.0], house, base_m).all()


def test_rays_in_chunks_see_the_same(monkeypatch):
    random = np.random.default_rng(5)
    triangles, points = drawn_triangles(random, 30), random.uniform(0, 30, (100, 3))
    at_once = seen(points, triangles)
    monkeypatch.setattr("isacbench.model.surfaces.surface_points.MOST_PAIRS", 700)
    np.testing.assert_array_equal(seen(points, triangles), at_once)


def test_no_surfaces_those_behind_the_base_station_and_those_without_area_hide_nothing():
    behind, flat = WALL + np.array([0.0, 120.0, 0.0]), np.repeat(WALL[:, :1], 3, axis=1)
    for triangles in (np.empty((0, 3, 3)), behind, flat):
        assert seen([[20, 5, 1], [20, 9, 0], [3, 0, 5]], triangles).all()
    assert seen(np.empty((0, 3)), WALL).shape == (0,)


@few
@given(SEEDS, st.floats(1e-2, 10))
def test_visibility_does_not_depend_on_where_the_origin_is(seed, spread):
    random = np.random.default_rng(seed)
    triangles, points = drawn_triangles(random, 20, spread), random.uniform(0, 30, (30, 3))
    shift = random.uniform(-1000, 1000, 3)
    moved = seen(points + shift, triangles + shift, BASE_M + shift)
    np.testing.assert_array_equal(seen(points, triangles), moved)
