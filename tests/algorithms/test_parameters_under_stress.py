"""Stress of built-in estimators by parameters of their own: subarrays, windows, single precision."""

import dataclasses
from itertools import product

import numpy as np
import pytest

from isacbench.checking.image_checks import EVERY, FOUND, RESOLVED_ECHOES, ImageSubject
from isacbench.checking.scenes import NARROW, RESOLVED, Echo, Layout, observed
from isacbench.errors import InputError
from isacbench.plugins.registry import get_detector, get_estimator
from tests.conftest import slow_but

SUBSPACES = ["music2d", "music2d_joint", "esprit2d", "capon2d"]
SHARES = [((8, 8), 0.5), ((8, 8), 1.0), ((5, 12), 0.01), ((3, 2), 0.01), ((3, 2), 1.0)]


@pytest.mark.parametrize(
    ("name", "shape", "fraction"),
    slow_but(
        [(name, *share) for i, name in enumerate(SUBSPACES) for share in SHARES[i % 2 :: 2]],
        product(SUBSPACES, [(8, 8), (5, 12), (3, 2)], [0.01, 0.5, 1.0]),
    ),
)
def test_one_echo_is_one_point_whatever_share_of_the_array_a_subarray_takes(name, shape, fraction):
    scene = observed([Echo(9.3, 0.7, 0.05, -0.08)], layout=Layout(array=shape, region=NARROW))
    image = ImageSubject(get_estimator(name, subarray_fraction=fraction), scene)
    for check in (*EVERY, *RESOLVED_ECHOES):
        assert check.measure(image) <= check.bound, check.name


@pytest.mark.parametrize(
    ("name", "training"),
    slow_but(
        [("fft4d", 1), ("fft4d", 12), ("music2d", 5), ("esprit2d", 1), ("iaa2d", 12), ("omp4d", 5)],
        product(["fft4d", "music2d", "esprit2d", "iaa2d", "omp4d"], [1, 5, 12]),
    ),
)
def test_echoes_are_found_with_any_window_that_fits_the_map(name, training):
    detector = get_detector("osca", training=training, order_axis=1)
    image = ImageSubject(get_estimator(name, detector=detector), observed(RESOLVED, 20.0))
    assert FOUND.measure(image) <= FOUND.bound


def test_a_window_larger_than_the_map_is_refused():
    detector = get_detector("osca", training=40, order_axis=1)
    with pytest.raises(InputError, match="window"):
        get_estimator("music2d", detector=detector).estimate(observed(RESOLVED, 20.0).observation())


@pytest.mark.parametrize(
    ("name", "snr_db"),
    slow_but(
        [("fft4d", 20.0), ("music2d", 60.0), ("esprit2d", 20.0), ("music2d_joint", 60.0)],
        product(["fft4d", "music2d", "esprit2d", "music2d_joint"], [20.0, 60.0]),
    ),
)
def test_every_stage_in_single_precision_is_that_in_double_precision(name, snr_db):
    estimator = get_estimator(name, precision="double")
    observation = observed(RESOLVED, snr_db).observation()
    double = estimator.diagnose(observation)
    single = estimator.diagnose(
        dataclasses.replace(observation, cells=observation.cells.astype(np.complex64))
    )
    assert single.cell == double.cell
    assert np.abs(single.power - double.power).max() < 1e-6 * double.power.max()
    np.testing.assert_array_equal(single.detection.mask, double.detection.mask)
    np.testing.assert_allclose(single.detection.threshold, double.detection.threshold, rtol=1e-4)
    for one, two in zip(single.spectra, double.spectra, strict=True):
        np.testing.assert_allclose(np.sort(one.peaks), np.sort(two.peaks), atol=1e-4)
