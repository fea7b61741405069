"""Scenarios: what a radio can observe at all, and the scatterers outside of what it looks at."""

import dataclasses
import re
import warnings

import numpy as np
import pytest

from isacbench.errors import InputError, InputWarning
from isacbench.model.array import VirtualArray
from isacbench.model.scenes.scenario import load_scenario


def test_the_truth_is_the_scatterers_with_their_power(make_scenario):
    scenario = make_scenario(amplitude=[1.0, 0.5, 3.0])
    np.testing.assert_array_equal(scenario.truth.xyz, scenario.scatterers.xyz)
    np.testing.assert_array_equal(scenario.truth.velocity, scenario.scatterers.velocity)
    assert scenario.truth.power.tolist() == [1.0, 0.25, 9.0]


def test_phases_are_zero_unless_given_one_a_scatterer(make_scenario):
    scatterers = make_scenario().scatterers
    assert scatterers.phase_rad.tolist() == [0.0, 0.0, 0.0]
    turned = dataclasses.replace(scatterers, phase_rad=[0.1, 0.2, 0.3])
    assert turned.phase_rad.tolist() == [0.1, 0.2, 0.3]
    with pytest.raises(ValueError, match="broadcast"):
        dataclasses.replace(scatterers, phase_rad=[0.1, 0.2])


def test_a_scene_may_be_empty(make_scenario):
    assert len(make_scenario(xyz=np.empty((0, 3)), velocity=[], amplitude=[]).truth) == 0


@pytest.mark.parametrize(
    ("frame", "place", "where"),
    [
        ("panel", (5, 50, 2), "in front of the panel"),
        ("paper", (5, 5, 11), "below the base station (z <= z of the base station)"),
        ("panel", (5, 40, 10), "in front of the panel"),
    ],
)
def test_a_scatterer_where_the_array_is_blind_is_refused(make_scenario, frame, place, where):
    message = f"objects: 1 of 2 scatterers, the first at {place} m, lie where the array is blind"
    with pytest.raises(InputError, match=re.escape(f"{message}; allowed are places {where}")):
        make_scenario(frame, xyz=[[1, 1, 1], place], velocity=[0, 0], amplitude=[1, 1])


@pytest.mark.parametrize(
    ("place", "speed_mps", "stray"),
    [
        ([10.0, 0.0, 5.0], 15.0, False),
        ([10.0, -1e-14, 5.0], 15.0, False),
        ([10.0, -1e-6, 5.0], 15.0, True),
        ([10.0, 0.0, 5.0], np.nextafter(15.0, 16.0), False),
        ([10.1, 0.0, 5.0], 15.0, True),
        ([10.0, 0.0, 5.0], -15.1, True),
    ],
)
def test_scatterers_outside_the_region_or_its_speeds_are_warned_of(make_scenario, place, speed_mps, stray):
    with warnings.catch_warnings(record=True, category=InputWarning, action="always") as caught:
        make_scenario(xyz=[[1, 1, 1], place], velocity=[0, speed_mps], amplitude=[1, 1])
    words = stray * ["scenario few: 1 of 2 scatterers lie outside the reg"]
    assert [str(warning.message)[:51] for warning in caught] == words


def test_arrays_are_copies_that_cannot_be_written_to(make_scenario):
    velocity = np.array([1.0, 2.0, 3.0])
    scenario = make_scenario(velocity=velocity)
    velocity[0] = 9.0
    assert scenario.scatterers.velocity[0] == 1.0
    for array in (scenario.base_station_m, scenario.scatterers.xyz, scenario.scatterers.amplitude):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0


@pytest.mark.parametrize("rx_shape", [(8, 1), (1, 8), (1, 1)])
def test_an_array_that_sees_no_direction_is_refused(rx_shape):
    street = load_scenario("street")
    with pytest.raises(InputError, match="virtual elements cannot measure both directions; at least 2"):
        dataclasses.replace(street, array=VirtualArray((1, 1), rx_shape, 1, 1))
