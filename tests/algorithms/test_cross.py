"""Estimators on one column and one row of the array: what they read, and what they pair."""

from functools import partial

import numpy as np
import pytest
from isacbench_algorithms.capon2d import Capon2d
from isacbench_algorithms.esprit2d import Esprit2d
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.music2d import Music2d
from isacbench_algorithms.music2d_joint import Music2dJoint
from isacbench_algorithms.omp4d import Omp4d

from isacbench.model.array import VirtualArray
from isacbench.plugins.contracts import Needs, needs_of
from tests.algorithms import scenes
from tests.algorithms.scenes import BASE_M, SYSTEM, XYZ

ARRAY = VirtualArray((2, 2), (4, 6), 4, 1)
simulator = partial(scenes.simulator, array=ARRAY)

SEPARABLE = pytest.mark.parametrize("estimator", [Music2d, Fft4d])


class OneCross:
    """An observation of which no more than one column and one row was computed."""

    def __init__(self, observation):
        self._observation, self.cross = observation, observation.cross

    def __getattr__(self, name):
        assert name != "cells", "the whole array was read"
        return getattr(self._observation, name)


@pytest.mark.parametrize("estimator", [Music2d, Fft4d, Esprit2d, Music2dJoint, Capon2d, Omp4d])
def test_a_cross_is_declared_where_one_element_detects_and_angles_are_separable_and_else_the_plane(estimator):
    elements = "cross" if estimator in (Music2d, Fft4d) else "plane"
    cells = "gate" if estimator is Omp4d else "detected"
    assert needs_of(estimator()) == Needs("plane", estimator().integration, cells)
    assert needs_of(estimator(integration="element")) == Needs(elements, "element", cells)


@SEPARABLE
def test_no_more_than_a_column_and_a_row_is_read(estimator):
    observation = simulator().observe(30.0)
    cross = OneCross(observation)
    one = estimator(integration="element")
    cloud = one.estimate(cross)
    assert len(cloud) == len(XYZ)
    np.testing.assert_array_equal(cloud.to_array(), one.estimate(observation).to_array())
    assert [spectrum.label for spectrum in one.diagnose(cross).spectra] == ["u", "w"]
    with pytest.raises(AssertionError, match="the whole array was read"):
        estimator().estimate(cross)


@SEPARABLE
def test_two_of_one_range_and_speed_are_paired_by_what_column_and_row_have_in_common(estimator):
    offset_m = np.array([[-10.0, -80.0, -15.0], [10.0, -79.0, -4.0]])
    offset_m *= 40.4 * SYSTEM.range_bin_m / np.linalg.norm(offset_m, axis=1, keepdims=True)
    scene = simulator(BASE_M + offset_m, [3.1, 3.1], [1.0, 0.6], array=VirtualArray((2, 2), (8, 16), 8, 1))
    for trial in range(2):
        cloud = estimator(integration="element").estimate(scene.observe(20.0, trial))
        assert len(cloud) == 2
        strongest = np.argsort(-cloud.power)
        # A fifth of a Rayleigh cell, which is what unresolved sidelobes cost; a wrong pair is off by 13 m.
        np.testing.assert_allclose(cloud.xyz[strongest], scene.scenario.truth.xyz, atol=2.5)
