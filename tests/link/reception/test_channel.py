from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import j0

from isacbench.link.reception import channel as channel_module
from isacbench.link.reception.channel import Awgn, Paths, TappedDelay, TwoRay, channel_response, delay_profile
from isacbench.link.waveform.ofdm import demodulate
from isacbench.link.waveform.resource_grid import draw_grid
from isacbench.model.echo import random_stream
from isacbench.model.numerology import System
from tests.conftest import refusal
from tests.link.sensing.propagation import propagate

PROFILES = ("tdl_a", "tdl_b", "tdl_c", "tdl_d", "tdl_e")
SMALL = System(n_subcarriers=128, n_symbols=9)
CHANNELS = (
    *(Awgn(), TwoRay(), TwoRay(distance_m=5, polarization="horizontal")),
    *(TappedDelay(), TappedDelay("tdl_c", 100e-9), TappedDelay("tdl_e", 40e-9)),
)


@pytest.fixture
def tables_read_once(monkeypatch):
    """Remember profiles: of many draws, reading the tables takes all the time."""
    monkeypatch.setattr(channel_module, "delay_profile", cache(delay_profile))


def draw(channel, system=SMALL, trial=0):
    return channel.paths(system, random_stream("draw", trial, 0))


@pytest.mark.parametrize("name", PROFILES)
def test_a_profile_has_unit_power_and_unit_delay_spread(name):
    # The tables are normalised so; a wrong digit would show. TDL-D is 0.6 % off as printed.
    profile = delay_profile(name)
    mean = profile.power @ profile.delay
    spread = np.sqrt(profile.power @ (profile.delay - mean) ** 2)
    assert profile.power.sum() == pytest.approx(1)
    assert spread == pytest.approx(1, rel=7e-3 if name == "tdl_d" else 3e-4)


@pytest.mark.parametrize(("name", "rice_db"), [("tdl_d", 13.3), ("tdl_e", 22.0)])
def test_the_line_of_sight_is_as_much_stronger_as_the_table_says(name, rice_db):
    profile = delay_profile(name)
    assert profile.has_line_of_sight
    assert profile.delay[1] == 0
    assert 10 * np.log10(profile.power[0] / profile.power[1]) == pytest.approx(rice_db)


@given(n_paths=st.integers(1, 5), speed_hz=st.sampled_from([0.0, 1000.0]), seed=st.integers(0, 2**16))
def test_the_closed_form_is_a_plain_double_loop(n_paths, speed_hz, seed):
    system = System(n_subcarriers=7, n_symbols=3)
    stream = np.random.default_rng(seed)
    gain = stream.standard_normal((n_paths, 2)) @ [1, 1j]
    delay_s = stream.uniform(0, system.isi_free_delay_s, n_paths)
    doppler_hz = stream.uniform(-speed_hz, speed_hz, n_paths)
    response = np.broadcast_to(channel_response(system, Paths(gain[:, None], delay_s, doppler_hz)), (7, 3))
    samples = (np.arange(7) - 3) / system.bandwidth_hz
    for n in range(7):
        for m in range(3):
            value = 0
            for g, tau, f in zip(gain, delay_s, doppler_hz, strict=True):
                turning = np.mean(np.exp(2j * np.pi * f * (samples + m * system.symbol_time_s)))
                value += g * turning * np.exp(-2j * np.pi * n * system.subcarrier_spacing_hz * tau)
            assert response[n, m] == pytest.approx(value, abs=1e-12 * n_paths)


@pytest.mark.parametrize("channel", CHANNELS)
def test_the_waveform_through_the_channel_is_the_closed_form_and_the_noise(channel):
    grid, paths = draw_grid(SMALL, "64qam"), draw(channel)
    waveform = propagate(grid.symbols, SMALL, paths)[:, 0]
    noise = random_stream("noise", 0, 0).standard_normal((waveform.size, 2)) @ [1, 1j]
    received = demodulate(waveform + noise, SMALL)
    noise_alone = demodulate(noise, SMALL)
    expected = channel_response(SMALL, paths) * grid.symbols + noise_alone
    np.testing.assert_allclose(received, expected, rtol=0, atol=1e-12)
    # Demodulated noise is white and has the power of a sample.
    n = noise_alone.size
    assert np.mean(np.abs(noise_alone) ** 2) == pytest.approx(2, abs=5 * 2 / np.sqrt(n))
    neighbours = np.mean(noise_alone[1:] * noise_alone[:-1].conj())
    assert abs(neighbours) < 5 * 2 / np.sqrt(n)


def test_what_the_closed_form_leaves_out_of_a_walking_user_is_the_interference_of_doppler():
    system = System(n_subcarriers=256, n_symbols=20)
    channel = TappedDelay("tdl_b", speed_mps=2.0)
    grid, paths = draw_grid(system), draw(channel, system)
    received = demodulate(propagate(grid.symbols, system, paths)[:, 0], system)
    left_out = received - channel_response(system, paths) * grid.symbols
    # The paths' interference to first order in Doppler: all of them turn the symbol by a ramp in time.
    frequency_hz = system.subcarrier_spacing_hz * np.arange(256)
    turns = np.exp(-2j * np.pi * np.outer(frequency_hz, paths.delay_s))
    slope = turns @ (paths.gain[:, 0] * paths.doppler_hz)
    expected = np.pi**2 / 3 * np.mean(np.abs(slope / system.subcarrier_spacing_hz) ** 2)
    assert 0 < expected < 1e-4
    # Paths turn against each other from symbol to symbol, hence not sharper.
    assert np.mean(np.abs(left_out) ** 2) == pytest.approx(expected, rel=0.3)


@pytest.mark.usefixtures("tables_read_once")
@pytest.mark.parametrize("name", PROFILES)
def test_a_fading_channel_has_unit_mean_power_and_the_correlation_of_its_profile(name):
    system = System(n_subcarriers=2, n_symbols=1)
    channel, n = TappedDelay(name, 40e-9), 500
    draws = np.array([channel_response(system, draw(channel, system, trial))[:, 0] for trial in range(n)])
    profile = delay_profile(name)
    turns = system.subcarrier_spacing_hz * 40e-9 * profile.delay
    assert np.mean(np.abs(draws) ** 2) == pytest.approx(1, abs=5 / np.sqrt(n))
    correlation = np.mean(draws[:, 1] * draws[:, 0].conj())
    assert correlation == pytest.approx(profile.power @ np.exp(-2j * np.pi * turns), abs=5 / np.sqrt(n))


@pytest.mark.usefixtures("tables_read_once")
def test_taps_fade_as_rayleigh_has_it():
    gains = np.array([draw(TappedDelay(), trial=trial).gain[:, 0] for trial in range(500)])
    power = np.abs(gains) ** 2 / delay_profile("tdl_a").power
    # Of an exponential the second moment is twice the square of the first.
    assert np.mean(power) == pytest.approx(1, abs=5 / np.sqrt(power.size))
    assert np.mean(power**2) == pytest.approx(2, abs=5 * np.sqrt(20 / power.size))


@pytest.mark.usefixtures("tables_read_once")
def test_a_moving_user_sees_the_correlation_of_rays_from_all_around():
    channel, n = TappedDelay("tdl_a", speed_mps=3.0), 500
    time_s = SMALL.symbol_time_s * np.array([0, 56, 112, 223])
    paths = [draw(channel, trial=trial) for trial in range(n)]
    turns = [np.exp(2j * np.pi * np.outer(time_s, one.doppler_hz)) for one in paths]
    draws = np.array([turn @ one.gain[:, 0] for turn, one in zip(turns, paths, strict=True)])
    correlation = np.mean(draws * draws[:, :1].conj(), axis=0)
    expected = j0(2 * np.pi * 3.0 / SMALL.wavelength_m * time_s)
    assert expected[-1] < 0.5
    np.testing.assert_allclose(correlation, expected, rtol=0, atol=5 / np.sqrt(n))


def test_a_user_at_rest_sees_one_response_in_all_symbols():
    assert channel_response(SMALL, draw(TappedDelay())).shape == (SMALL.n_subcarriers, 1)


@given(
    distance_m=st.floats(1, 1e4),
    heights_m=st.tuples(st.floats(0.5, 50), st.floats(0.5, 50)),
    polarization=st.sampled_from(["vertical", "horizontal"]),
)
def test_two_rays_have_unit_mean_power_and_the_delay_of_mirror_geometry(distance_m, heights_m, polarization):
    channel = TwoRay(*heights_m, distance_m, polarization=polarization)
    paths = draw(channel)
    # Small grazing delays cancel in the difference of distances: hence the tolerance.
    longer_m = np.hypot(distance_m, sum(heights_m)) - np.hypot(distance_m, heights_m[0] - heights_m[1])
    assert paths.delay_s[1] * 299792458.0 == pytest.approx(longer_m, rel=1e-9, abs=1e-11)
    if paths.delay_s[1] <= SMALL.isi_free_delay_s:
        assert np.mean(np.abs(channel_response(SMALL, paths)) ** 2) == pytest.approx(1)
    # A passive ground reflects no more than arrives, over a longer way.
    assert abs(paths.gain[1, 0]) < abs(paths.gain[0, 0])


@pytest.mark.parametrize("permittivity", [1.5, 5.24, 80.0])
def test_reflection_obeys_the_laws_of_fresnel(permittivity):
    def coefficient(sine, polarization, conductivity_spm=0.0):
        return channel_module.reflection_coefficient(sine, permittivity, conductivity_spm, 70e9, polarization)

    index = np.sqrt(permittivity)
    normal = (index - 1) / (index + 1)
    assert coefficient(1.0, "vertical") == pytest.approx(normal)
    assert coefficient(1.0, "horizontal") == pytest.approx(-normal)
    for polarization in ("vertical", "horizontal"):
        assert coefficient(1e-9, polarization) == pytest.approx(-1, abs=1e-6)
    # At Brewster's angle the two rays are perpendicular.
    brewster = np.sin(np.arctan(1 / index))
    assert abs(coefficient(brewster, "vertical")) < 1e-12
    assert abs(coefficient(brewster, "vertical", conductivity_spm=1.28)) > 0
    # Energy: what is not reflected is refracted, with the ratio of the normal wave vectors.
    sine, refracted = 0.3, np.sqrt(permittivity - 1 + 0.09)
    reflection = coefficient(sine, "horizontal")
    assert abs(reflection) ** 2 + refracted / sine * abs(1 + reflection) ** 2 == pytest.approx(1)


def test_a_metal_ground_reflects_everything():
    for polarization, coefficient in (("horizontal", -1), ("vertical", 1)):
        found = channel_module.reflection_coefficient(0.5, 1.0, 1e12, 70e9, polarization)
        assert found == pytest.approx(coefficient, abs=1e-4)


def test_a_channel_that_cannot_be_is_refused():
    for message, (kind, parameters) in {
        "distance_m = 0": (TwoRay, {"distance_m": 0}),
        "ue_height_m = nan": (TwoRay, {"ue_height_m": float("nan")}),
        "base_station_height_m = 1e+200": (TwoRay, {"base_station_height_m": 1e200}),
        "permittivity = 0.5": (TwoRay, {"permittivity": 0.5}),
        "conductivity_spm = -1": (TwoRay, {"conductivity_spm": -1}),
        "unknown polarization 'circular'": (TwoRay, {"polarization": "circular"}),
        "unknown profile 'tdl_z'": (TappedDelay, {"profile": "tdl_z"}),
        "delay_spread_s = -1e-09": (TappedDelay, {"delay_spread_s": -1e-9}),
        "speed_mps = -1": (TappedDelay, {"speed_mps": -1}),
    }.items():
        assert message in refusal(kind, **parameters)


def test_paths_beyond_the_prefix_and_fast_ones_have_no_closed_form():
    late, fast = draw(TappedDelay("tdl_e", 53e-9)), Paths([[1.0]], [0.0], [5000.0])
    message = "path at 1.09455e-06 s: the closed form allows 9.11458e-07 s"
    assert message in refusal(channel_response, SMALL, late)
    assert "Doppler of 0.0208 subcarrier spacings" in refusal(channel_response, SMALL, fast)


def test_paths_that_are_none_are_refused():
    for message, paths in {
        "paths: gain (2,), delay_s (2,)": (np.ones(2), np.zeros(2), np.zeros(2)),
        "doppler_hz (3,); allowed are the shapes": (np.ones((2, 1)), np.zeros(2), np.zeros(3)),
        "paths.gain holds nan; allowed are finite numbers": ([[np.nan]], [0.0], [0.0]),
        "paths.delay_s holds -1e-09; allowed are finite numbers of 0": ([[1.0]], [-1e-9], [0.0]),
        "paths.doppler_hz holds inf; allowed are finite numbers": ([[1.0]], [0.0], [np.inf]),
    }.items():
        assert message in refusal(Paths, *paths)
