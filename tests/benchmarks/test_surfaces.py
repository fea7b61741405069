"""Time of scenes whose objects hide each other, and of a city of 40 000 faces."""

import numpy as np
import pytest

from isacbench import load_scenario
from isacbench.model.scenes.solids import cuboid
from isacbench.model.surfaces.surface_points import NO_PART, seen_points, surface_points

BASE_M = np.array([0.0, 200.0, 40.0])


@pytest.fixture(scope="module")
def city():
    """Triangles of 3400 houses within 200 x 200 m."""
    random = np.random.default_rng(0)
    lower = np.column_stack([random.uniform(-100, 100, (3400, 2)), np.zeros(3400)])
    return np.concatenate([cuboid(corner, corner + random.uniform(2, 5, 3)) for corner in lower])


@pytest.mark.parametrize("visible", ["all", "seen"])
def test_load_traffic(benchmark, visible):
    benchmark(load_scenario, f"traffic[seed=7,visible={visible}]")


def test_sample_a_city(benchmark, city):
    assert len(benchmark(surface_points, city, 1.5)) > 50_000


def test_what_is_seen_of_a_city(benchmark, city):
    points = surface_points(city, 1.5)
    part = np.full(len(points), NO_PART)
    is_seen = benchmark(seen_points, BASE_M, points, part, city, np.zeros(len(city), dtype=int))
    assert 0 < is_seen.mean() < 0.5
