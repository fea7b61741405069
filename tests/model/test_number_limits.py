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

VALID = {
    System: {},
    VirtualArray: {},
    Region: {"x_m": (0.0, 1.0), "y_m": (0.0, 1.0), "z_m": (0.0, 1.0), "speed_mps": (0.0, 1.0)},
    Scatterers: {"xyz": [[0.0, 0.0, 0.0]], "velocity": [0.0], "amplitude": [1.0]},
}
WRONG = [
    *((System, "n_subcarriers", value, "n_subcarriers = {}: allowed is") for value in (0, 2.0)),
    *((System, "n_symbols", value, "n_symbols = {}: allowed is") for value in (True, 10**12)),
    *((System, "carrier_hz", value, "carrier_hz = {}: allowed is") for value in (0.0, -7e10, math.inf)),
    (System, "subcarrier_spacing_hz", math.nan, "subcarrier_spacing_hz = {}: allowed is"),
    (System, "cyclic_prefix_ratio", -0.1, "cyclic_prefix_ratio = {}: allowed is"),
    (System, "cyclic_suffix_ratio", 1.1, "cyclic_suffix_ratio = {}: allowed is"),
    (VirtualArray, "tx_shape", (0, 1), "array.tx_shape = 0: allowed is a whole number from 1"),
    (VirtualArray, "rx_shape", (8, -1), "array.rx_shape = -1: allowed is a whole number from 1"),
    (VirtualArray, "tx_spacing", 0, "array.tx_spacing = {}: allowed is a whole number from 1"),
    (VirtualArray, "rx_spacing", 1.5, "array.rx_spacing = {}: allowed is a whole number from 1"),
    (Region, "x_m", (1.0, 0.0), "region.x_m = {}: allowed is two ascending numbers"),
    (Region, "y_m", (0.0, math.nan), "region.y_m = {}: allowed is two ascending numbers"),
    (Region, "z_m", (-math.inf, 0.0), "region.z_m = {}: allowed is two ascending numbers"),
    (Region, "x_m", (0.0, 1e10), "region.x_m = {}: allowed is two ascending numbers"),
    (Region, "speed_mps", (0.0, 1e9), "region.speed_mps = {}: allowed is two ascending numbers"),
    (Scatterers, "xyz", [[0.0, math.nan, 0.0]], "scatterers.xyz holds nan"),
    (Scatterers, "xyz", [[0.0, 0.0, 2e9]], "scatterers.xyz holds 2e+09"),
    (Scatterers, "velocity", [math.inf], "scatterers.velocity holds inf"),
    (Scatterers, "velocity", [3e8], "scatterers.velocity holds 3e+08"),
    (Scatterers, "amplitude", [math.nan], "scatterers.amplitude holds nan"),
    (Scatterers, "phase_rad", math.inf, "scatterers.phase_rad holds inf"),
    (Scatterers, "amplitude", [1e160], "scatterers.amplitude, summed in power, holds 1e+160"),
    (Scatterers, "amplitude", [5e-324], "scatterers.amplitude, summed in power, holds 4.94066e-324"),
    (Scatterers, "xyz", [[0.0, 0.0]], "scatterers: xyz (1, 2), velocity (1,) and amplitude (1,)"),
    (Scatterers, "amplitude", [1.0, 2.0], "scatterers: xyz (1, 3), velocity (1,)"),
]


@pytest.mark.parametrize(("kind", "key", "value", "message"), WRONG)
def test_what_no_radio_region_or_scatterer_has_is_refused(kind, key, value, message):
    with pytest.raises(InputError, match=f"^{re.escape(message.format(value))}"):
        kind(**{**VALID[kind], key: value})


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
def test_scatterers_beyond_the_cyclic_prefix_are_warned_of(make_scenario, excess_m, n_late):
    late_m = make_scenario().system.isi_free_range_m + excess_m
    xyz = [[5.0, 40.0 - late_m, 10.0], [1.0, 1.0, 1.0]]
    with pytest.warns(InputWarning) as caught:
        make_scenario(xyz=xyz, velocity=[0.0, 0.0], amplitude=[1.0, 1.0])
    messages = [str(warning.message) for warning in caught if "cyclic prefix" in str(warning.message)]
    assert len(messages) == n_late
    assert all("1 of 2 scatterers lie beyond 136.6 m" in message for message in messages)
