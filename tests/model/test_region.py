"""The region's distances and borders."""

import itertools

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from isacbench.model.region import Region

LIMITS = st.tuples(st.floats(-100, 100), st.floats(-100, 100)).map(lambda limits: tuple(sorted(limits)))
REGIONS = st.builds(Region, x_m=LIMITS, y_m=LIMITS, z_m=LIMITS, speed_mps=st.just((-1.0, 1.0)))
PLACES = st.tuples(*[st.floats(-150, 150)] * 3)


@given(REGIONS, PLACES)
@example(Region((0, 30), (0, 20), (0, 20), (-15, 15)), (3, 4, 5))
def test_range_limits_are_the_closest_and_farthest_points_of_a_sampled_box(region, base):
    nearest_m, farthest_m = region.range_limits_m(base)
    sampled = [
        np.hypot(np.hypot(x - base[0], y - base[1]), z - base[2])
        for x, y, z in itertools.product(
            *(
                [low, high, *np.linspace(low, high, 4), np.clip(place, low, high)]
                for (low, high), place in zip((region.x_m, region.y_m, region.z_m), base, strict=True)
            )
        )
    ]
    assert nearest_m == pytest.approx(min(sampled), abs=1e-9)
    assert farthest_m == pytest.approx(max(sampled), abs=1e-9)


def test_limits_and_tolerance_belong_to_the_region_and_nan_does_not():
    region = Region((0, 1), (0, 1), (0, 1), (-1, 1))
    places = [[1, 0, 1], [1.5, 0, 0], [0, -0.5, 0], [0, 0, 1.6], [np.nan, 0.5, 0.5]]
    assert region.contains(places).tolist() == [True, False, False, False, False]
    assert region.contains(places, 0.5).tolist() == [True, True, True, False, False]


def test_corners_and_size_follow_from_the_limits():
    region = Region((0, 3), (1, 2), (-1, 4), (-1, 1))
    assert region.size_m.tolist() == [3, 1, 5]
    assert {tuple(corner) for corner in region.corners_m} == {
        (x, y, z) for x in (0, 3) for y in (1, 2) for z in (-1, 4)
    }
