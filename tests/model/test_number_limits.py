"""What cannot be simulated or scored is refused where it comes in, and said so."""

import dataclasses
import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.errors import InputError, InputWarning
from isacbench.model.array import VirtualArray
from isacbench.model.number_limits import LARGEST_AMPLITUDE, SMALLEST_AMPLITUDE
from isacbench.model.numerology import System
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("n_subcarriers", 0),
        ("n_subcarriers", 2.0),
        ("n_symbols", True),
        ("n_symbols", 10**12),
        ("carrier_hz", 0.0),
        ("carrier_hz", -7e10),
        ("carrier_hz", math.inf),
        ("subcarrier_spacing_hz", math.nan),
        ("cyclic_prefix_ratio", -0.1),
        ("cyclic_suffix_ratio", 1.1),
    ],
)
def test_a_numerology_that_is_none_is_refused(key, value):
    with pytest.raises(InputError, match=rf"^{key} = .*: allowed is"):
        System(**{key: value})


@pytest.mark.parametrize(
    "array", [{"tx_shape": (0, 1)}, {"rx_shape": (8, -1)}, {"tx_spacing": 0}, {"rx_spacing": 1.5}]
)
def test_an_array_without_elements_or_spacing_is_refused(array):
    with pytest.raises(InputError, match=rf"^array.{next(iter(array))} = .*a whole number from 1"):
        VirtualArray(**array)


@pytest.mark.parametrize(
    ("key", "limits"),
    [
        ("x_m", (1.0, 0.0)),
        ("y_m", (0.0, math.nan)),
        ("z_m", (-math.inf, 0.0)),
        ("x_m", (0.0, 1e10)),
        ("speed_mps", (0.0, 1e9)),
    ],
)
def test_a_region_whose_limits_are_none_is_refused(key, limits):
    box = {"x_m": (0.0, 1.0), "y_m": (0.0, 1.0), "z_m": (0.0, 1.0), "speed_mps": (0.0, 1.0)}
    with pytest.raises(InputError, match=rf"^region.{key} = .*two ascending numbers"):
        Region(**{**box, key: limits})


@pytest.mark.parametrize(
    ("xyz", "velocity", "amplitude", "phase_rad", "message"),
    [
        ([[0.0, math.nan, 0.0]], [0.0], [1.0], 0.0, "scatterers.xyz holds nan"),
        ([[0.0, 0.0, 2e9]], [0.0], [1.0], 0.0, "scatterers.xyz holds 2e+09"),
        ([[0.0, 0.0, 0.0]], [math.inf], [1.0], 0.0, "scatterers.velocity holds inf"),
        ([[0.0, 0.0, 0.0]], [3e8], [1.0], 0.0, "scatterers.velocity holds 3e+08"),
        ([[0.0, 0.0, 0.0]], [0.0], [math.nan], 0.0, "scatterers.amplitude holds nan"),
        ([[0.0, 0.0, 0.0]], [0.0], [1.0], math.inf, "scatterers.phase_rad holds inf"),
        ([[0.0, 0.0, 0.0]], [0.0], [1e160], 0.0, "summed in power, holds 1e+160"),
        ([[0.0, 0.0, 0.0]], [0.0], [5e-324], 0.0, "summed in power, holds 4.94066e-324"),
        ([[0.0, 0.0]], [0.0], [1.0], 0.0, "scatterers: xyz (1, 2), velocity (1,) and amplitude (1,)"),
        ([[0.0, 0.0, 0.0]], [0.0], [1.0, 2.0], 0.0, "scatterers: xyz (1, 3), velocity (1,)"),
    ],
)
def test_scatterers_that_doubles_do_not_hold_are_refused(xyz, velocity, amplitude, phase_rad, message):
    with pytest.raises(InputError, match=re.escape(message)):
        Scatterers(xyz, velocity, amplitude, phase_rad)


@pytest.mark.parametrize("amplitude", [[0.0, 0.0], [1.0, 5e-324], [LARGEST_AMPLITUDE, 0.0], [-1.0, 1.0]])
def test_weak_echoes_beside_others_and_silence_are_allowed(amplitude):
    scatterers = Scatterers(np.zeros((2, 3)), np.zeros(2), amplitude)
    assert scatterers.total_amplitude == pytest.approx(math.hypot(*amplitude), rel=1e-15)


@given(st.lists(st.floats(SMALLEST_AMPLITUDE, LARGEST_AMPLITUDE / 10), min_size=1, max_size=9))
def test_the_total_amplitude_is_the_root_of_the_power_sum_at_any_scale(amplitude):
    n = len(amplitude)
    total = Scatterers(np.zeros((n, 3)), np.zeros(n), amplitude).total_amplitude
    assert total == pytest.approx(math.hypot(*amplitude), rel=1e-13)


@pytest.mark.parametrize("shift_m", [0.0, 1e-200, 1e-10])
def test_a_scatterer_at_the_base_station_has_no_direction_and_is_refused(make_scenario, shift_m):
    with pytest.raises(InputError, match="lie where the array is blind"):
        make_scenario(xyz=[[5.0 + shift_m, 40.0, 10.0]], velocity=[0.0], amplitude=[1.0])


def test_a_base_station_a_light_minute_away_is_refused(make_scenario):
    with pytest.raises(InputError, match=r"base_station_m holds 1.8e\+10"):
        dataclasses.replace(make_scenario(), base_station_m=[0.0, 1.8e10, 0.0])


@pytest.mark.parametrize(("excess_m", "n_late"), [(-0.01, 0), (0.01, 1)])
def test_scatterers_beyond_the_cyclic_prefix_are_warned_of(make_scenario, recwarn, excess_m, n_late):
    late_m = make_scenario().system.isi_free_range_m + excess_m
    with pytest.warns(InputWarning) as caught:
        make_scenario(
            xyz=[[5.0, 40.0 - late_m, 10.0], [1.0, 1.0, 1.0]], velocity=[0.0, 0.0], amplitude=[1.0, 1.0]
        )
    messages = [str(warning.message) for warning in caught if "cyclic prefix" in str(warning.message)]
    assert len(messages) == n_late
    assert all("1 of 2 scatterers lie beyond 136.6 m" in message for message in messages)
