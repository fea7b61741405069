"""Estimators on one column and one row of the array: what they read, and what they see."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from isacbench_algorithms.capon2d import Capon2d
from isacbench_algorithms.esprit2d import Esprit2d
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.music2d import Music2d
from isacbench_algorithms.music2d_joint import Music2dJoint
from isacbench_algorithms.omp4d import Omp4d

from isacbench.model.array import VirtualArray
from isacbench.model.echo import observe_echo
from isacbench.model.scenes.scenario import load_scenario
from isacbench.plugins.contracts import Needs, needs_of
from tests.algorithms import scenes
from tests.algorithms.scenes import BASE_M, SYSTEM, XYZ
from tests.conftest import few
from tests.single_scores import paper_scores

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


@SEPARABLE
def test_a_cross_is_declared_where_one_element_detects_and_the_plane_otherwise(estimator):
    assert needs_of(estimator()) == Needs("plane", "noncoherent", "detected")
    assert needs_of(estimator(integration="element")) == Needs("cross", "element", "detected")


@pytest.mark.parametrize("estimator", [Esprit2d, Music2dJoint, Capon2d, Omp4d])
def test_planar_methods_declare_the_plane_however_they_detect(estimator):
    for integration in ("noncoherent", "element"):
        assert needs_of(estimator(integration=integration)).elements == "plane"


def test_a_pursuit_declares_all_cells_of_the_gate():
    assert needs_of(Omp4d()) == Needs("plane", "noncoherent", "gate")


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
def test_what_other_elements_hold_does_not_matter(estimator):
    observation = simulator().observe(20.0)
    cells = observation.cells.copy()
    cells[:, :, 1:, 1:] = np.nan
    clouds = [
        estimator(integration="element").estimate(seen)
        for seen in (observation, replace(observation, cells=cells))
    ]
    assert len(clouds[0]) == len(XYZ)
    np.testing.assert_array_equal(*(cloud.to_array() for cloud in clouds))


@SEPARABLE
@few
@given(
    place=st.tuples(st.floats(2, 28), st.floats(2, 38), st.floats(1, 15)),
    velocity=st.floats(-24, 24),
    trial=st.integers(0, 99),
)
def test_a_lone_strong_scatterer_is_found_alone_within_a_twentieth_of_a_cell(
    estimator, place, velocity, trial
):
    scene = simulator([place], [velocity])
    # 40 dB above the noise of one element after the transforms.
    observation = scene.observe(40 - 10 * np.log10(SYSTEM.processing_gain), trial)
    cloud = estimator(integration="element").estimate(observation)
    assert len(cloud) == 1
    truth = scene.scenario.truth
    cosines = [np.array(scene.scenario.frame.direction_cosines(seen.xyz - BASE_M)) for seen in (cloud, truth)]
    ranges_m = [np.linalg.norm(seen.xyz - BASE_M) for seen in (cloud, truth)]
    assert np.abs((cosines[0] - cosines[1])[:, 0] * np.array(ARRAY.shape) / 2).max() < 0.05
    assert abs(ranges_m[0] - ranges_m[1]) < 0.05 * SYSTEM.range_bin_m
    assert abs(cloud.velocity[0] - velocity) < 0.05 * SYSTEM.velocity_bin_mps
    assert abs(10 * np.log10(cloud.power[0])) < 1


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


@pytest.mark.parametrize(("estimator", "limit_m"), [(Music2d, 8.5), (Fft4d, 15.0)])
def test_the_street_is_imaged_by_31_of_256_elements(estimator, limit_m):
    scenario = load_scenario("street")
    cloud = estimator(integration="element").estimate(OneCross(observe_echo(scenario, 10.0)))
    found = paper_scores(scenario.truth, cloud, scenario.region, scenario.system.velocity_bin_mps)
    assert found.hausdorff_sum_m < limit_m
    assert found.velocity_nmse < 2e-3
