"""Single precision of the tested map: points stay where they are."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from isacbench_algorithms.esprit2d import Esprit2d
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.music2d import Music2d
from isacbench_algorithms.music2d_joint import Music2dJoint

from tests.algorithms.scenes import XYZ, simulator

ALL = pytest.mark.parametrize("estimator", [Music2d, Fft4d, Esprit2d, Music2dJoint])


@cache
def observation():
    """Few scatterers in front of a panel, 30 dB."""
    return simulator().observe(30.0)


@ALL
def test_in_double_cells_of_single_precision_are_what_they_are(estimator):
    rounded = observation().cells.astype(np.complex64)
    both = (replace(observation(), cells=cells) for cells in (rounded, rounded.astype(np.complex128)))
    clouds = [estimator(precision="double").estimate(one) for one in both]
    assert len(clouds[0]) == len(XYZ)
    np.testing.assert_array_equal(*(cloud.to_array() for cloud in clouds))


@ALL
def test_single_precision_is_that_of_the_tested_map_and_moves_no_point(estimator):
    clouds, powers = [], []
    for precision in ("single", "double"):
        one = estimator(precision=precision)
        clouds.append(one.estimate(observation()).to_array())
        powers.append(one.diagnose(observation()).power)
    assert len(clouds[0]) == len(XYZ)
    np.testing.assert_array_equal(*clouds)
    assert np.any(powers[0] != powers[1])
    np.testing.assert_allclose(powers[0], powers[1], rtol=1e-5, atol=1e-9 * powers[1].max())


@pytest.mark.parametrize(
    ("estimator", "precision"),
    [(Music2d, "single"), (Fft4d, "single"), (Esprit2d, "double"), (Music2dJoint, "double")],
)
def test_the_default_is_single_where_no_curve_feels_it(estimator, precision):
    assert estimator().precision == precision
