"""Occupancy pictures: limit cases, invariances, and scikit-image's Hausdorff distance as a check of ours."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from skimage.metrics import hausdorff_distance

from isacbench import load_scenario
from isacbench.metrics.geometry import CloudPair, hausdorff_m
from isacbench.metrics.occupancy import PROJECTIONS, Occupancy, occupancy_pictures
from isacbench.model.cloud import PointCloud

STREET = load_scenario("street")


def test_the_truth_is_like_itself_and_nothing_has_an_error_of_one():
    same = Occupancy().score(CloudPair.of(STREET, STREET.truth))
    assert same == pytest.approx({"ssim": 1.0, "occupancy_nrmse": 0.0})
    empty = Occupancy().score(CloudPair.of(STREET, PointCloud.empty()))
    assert empty["occupancy_nrmse"] == 1.0
    assert empty["ssim"] < 0.01


def test_similarity_falls_with_the_distance_that_an_image_is_moved():
    truth, shifts = STREET.truth, np.array([0, 0.5, 1.5, 4])
    moved = [PointCloud(truth.xyz + shift * np.eye(3)[0], truth.velocity) for shift in shifts]
    found = [Occupancy().score(CloudPair.of(STREET, one)) for one in moved]
    assert (np.diff([one["ssim"] for one in found]) < 0).all()
    assert (np.diff([one["occupancy_nrmse"] for one in found]) > 0).all()


def test_a_lone_point_is_a_spot_of_height_one_in_the_middle_of_its_pixel():
    pair = CloudPair(PointCloud([[0, 0, 0], [9, 9, 9]]), PointCloud([[4.6, 4.6, 4.6]]))
    for axes in PROJECTIONS:
        _, picture = occupancy_pictures(pair, axes)
        assert picture.max() == pytest.approx(1.0, abs=1e-3)
        assert np.unravel_index(picture.argmax(), picture.shape) == (9 + 3, 9 + 3)


@given(seed=st.integers(0, 1000), n=st.integers(1, 30), m=st.integers(0, 30), copies=st.integers(1, 5))
def test_neither_order_nor_copies_change_a_picture(seed, n, m, copies):
    rng = np.random.default_rng(seed)
    truth, estimate = (PointCloud(rng.uniform(0, 9, (k, 3)), np.zeros(k)) for k in (n, m))
    plain = Occupancy().score(CloudPair(truth, estimate))
    again = np.tile(estimate.xyz[rng.permutation(m)], (copies, 1))
    twice = Occupancy().score(CloudPair(truth, PointCloud(again, np.zeros(len(again)))))
    assert twice == pytest.approx(plain, abs=1e-12)


@given(seed=st.integers(0, 1000), n=st.integers(1, 20), m=st.integers(1, 20))
def test_the_hausdorff_distance_is_that_of_scikit_image_in_pixels(seed, n, m):
    rng = np.random.default_rng(seed)
    places = [rng.integers(0, 25, (k, 3)) for k in (n, m)]
    pictures = [np.zeros((25, 25, 25), dtype=bool) for _ in places]
    for picture, xyz in zip(pictures, places, strict=True):
        picture[tuple(xyz.T)] = True
    assert hausdorff_m(*map(np.asarray, places)) == pytest.approx(hausdorff_distance(*pictures))
