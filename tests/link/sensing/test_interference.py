"""Interference in closed form, against the map from all that is sent to all received, and in the mean."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.link.reception.channel import Paths
from isacbench.link.waveform.ofdm import demodulate, layout
from isacbench.link.waveform.qam import constellation
from isacbench.link.waveform.resource_grid import draw_grid
from isacbench.model.numerology import SPEED_OF_LIGHT_MPS, System
from tests.link.sensing.interference import echo_interference, path_interference
from tests.link.sensing.propagation import propagate

SMALL = System(n_subcarriers=8, n_symbols=3, cyclic_prefix_ratio=0.25, cyclic_suffix_ratio=0.125)
WHOLE_SYMBOL = 10
"""Samples of a symbol of the small system, with its prefix of 2."""


def link_map(system, delay_samples, doppler_ratio):
    """Everything received of a unit path, of every resource element sent: (n, m received, n, m sent)."""
    shape = system.n_subcarriers, system.n_symbols
    paths = Paths(
        [[1.0]],
        [delay_samples / system.bandwidth_hz],
        [doppler_ratio * system.subcarrier_spacing_hz],
    )
    received = np.empty((*shape, *shape), dtype=complex)
    for place in np.ndindex(shape):
        grid = np.zeros(shape)
        grid[place] = 1
        received[:, :, *place] = demodulate(propagate(grid, system, paths), system)[:, :, 0]
    return received


def closed_form(system, delay_samples, doppler_ratio):
    """Unit echo (n, m) as the closed form has it."""
    n, m = np.arange(system.n_subcarriers)[:, None], np.arange(system.n_symbols)
    turn = doppler_ratio * (1 + system.cyclic_prefix_ratio)
    return np.exp(2j * np.pi * (m * turn - n * delay_samples / system.n_subcarriers))


@pytest.mark.parametrize("doppler_ratio", [1e-9, 1e-6, 1e-3, 1e-2])
def test_interference_of_slow_echoes_grows_as_the_square_of_their_speed(doppler_ratio):
    system = System()
    _, power = path_interference(system, 0.0, doppler_ratio * system.subcarrier_spacing_hz)
    assert power == pytest.approx((np.pi * doppler_ratio) ** 2 / 3, rel=1e-6 + 2 * doppler_ratio**2)


@given(doppler_ratio=st.floats(-1.5, 1.5), share=st.floats(0, 1))
def test_inside_the_undisturbed_prefix_what_is_not_useful_interferes(doppler_ratio, share):
    delay_s = share * 1 / SMALL.bandwidth_hz
    useful, power = path_interference(SMALL, delay_s, doppler_ratio * SMALL.subcarrier_spacing_hz)
    gain = np.mean(np.exp(2j * np.pi * doppler_ratio * (np.arange(8) - 3.5) / 8)).real
    assert useful == pytest.approx(gain, abs=1e-12)
    assert power == pytest.approx(1 - gain**2, abs=1e-12)


# Within the prefix, on its falling edge, beyond it, and where two or only earlier symbols show.
@pytest.mark.parametrize(
    ("delay_samples", "doppler_ratio"),
    [(0.65, 0.13), (1.35, -0.8), (4.75, 0), (8.5, 0.13), (15.4, -0.8)],
)
def test_gain_and_interference_are_those_of_the_whole_map(delay_samples, doppler_ratio):
    whole = link_map(SMALL, delay_samples, doppler_ratio)
    gain, interference = path_interference(
        SMALL, delay_samples / SMALL.bandwidth_hz, doppler_ratio * SMALL.subcarrier_spacing_hz
    )
    useful = np.einsum("nmnm->nm", whole)
    echo = closed_form(SMALL, delay_samples, doppler_ratio)
    np.testing.assert_allclose(useful, gain * echo, atol=1e-12)
    power = np.sum(np.abs(whole) ** 2, axis=(2, 3)) - np.abs(useful) ** 2
    # Two symbols precede the third: more can show nothing at these delays.
    np.testing.assert_allclose(power[:, 2:], interference, atol=1e-12)


def test_only_symbols_that_were_sent_before_interfere():
    delay_samples = WHOLE_SYMBOL + 1.6
    delay_s, doppler_hz = delay_samples / SMALL.bandwidth_hz, 0.1 * SMALL.subcarrier_spacing_hz
    every_symbol = link_map(SMALL, delay_samples, 0.1)
    for n_previous in range(3):
        whole = every_symbol[:, n_previous]
        _, expected = path_interference(SMALL, delay_s, doppler_hz, n_previous)
        useful = whole[np.arange(8), np.arange(8), n_previous]
        power = np.sum(np.abs(whole) ** 2, axis=(1, 2)) - np.abs(useful) ** 2
        np.testing.assert_allclose(power, expected, atol=1e-12)


def test_without_suffix_useful_amplitude_falls_by_a_sample_a_sample():
    system = System(n_subcarriers=64, n_symbols=2, cyclic_suffix_ratio=0.0)
    late = np.arange(40)
    gain, power = np.transpose([path_interference(system, one / system.bandwidth_hz, 0.0) for one in late])
    share = np.clip(late - 16, 0, None) / 64
    np.testing.assert_allclose(gain, 1 - share, atol=1e-14)
    # Amplitudes 1 - s of a symbol and s of the one before, s of the window each: 1 - (1 - s)².
    np.testing.assert_allclose(power, 1 - (1 - share) ** 2, atol=1e-14)


@pytest.mark.parametrize(
    ("modulation", "range_m", "velocity_mps"),
    [("qpsk", 50.0, 150.0), ("256qam", 50.0, 150.0), ("16qam", 220.0, 0.0), ("256qam", 300.0, -80.0)],
)
def test_the_error_of_a_divided_grid_is_the_stated_one_in_the_mean(modulation, range_m, velocity_mps):
    system = System(n_subcarriers=512, n_symbols=57)
    grid = draw_grid(system, modulation, trial=3)
    delay_s = 2 * range_m / SPEED_OF_LIGHT_MPS
    doppler_hz = 2 * velocity_mps * system.carrier_hz / SPEED_OF_LIGHT_MPS
    paths = Paths([[1.0]], [delay_s], [doppler_hz])
    received = demodulate(propagate(grid.symbols, system, paths), system)[:, :, 0]
    echo = closed_form(system, delay_s * system.bandwidth_hz, doppler_hz / system.subcarrier_spacing_hz)
    gain, power = echo_interference(system, range_m, velocity_mps)
    # The PRS has unit modulus throughout; the first symbol has nothing before it.
    data = np.where(grid.is_prs[:, 1:], np.nan, 1.0)
    error = (received / grid.symbols / echo)[:, 1:] * data - 1
    of_data = np.abs(error[np.isfinite(error)]) ** 2
    spread = of_data.std() / np.sqrt(of_data.size)
    mean_inverse_power = np.mean(1 / np.abs(constellation(modulation)) ** 2)
    expected = np.abs(1 - gain) ** 2 + mean_inverse_power * power
    assert of_data.mean() == pytest.approx(expected, abs=5 * spread)
    useful = (1 + error[np.isfinite(error)]).mean()
    assert useful == pytest.approx(gain, abs=5 * np.sqrt(of_data.mean() / of_data.size))


def test_interference_begins_where_the_undisturbed_prefix_ends():
    system = System()
    before_m, behind_m = np.array([-0.2, 0.7]) + system.isi_free_range_m
    before, behind = (echo_interference(system, range_m, 0.0)[1] for range_m in (before_m, behind_m))
    assert before == 0
    assert behind > 1e-12


def test_an_echo_of_nothing_but_earlier_symbols_has_no_useful_gain():
    parts, system = layout(SMALL), SMALL
    gain, power = path_interference(system, (parts.n_symbol + 0.5) / system.bandwidth_hz, 0.0)
    assert gain == 0
    assert power > 0
    delay_s = (parts.n_symbol + 0.5) / system.bandwidth_hz
    assert path_interference(system, delay_s, 0.0, n_previous=0) == (0, 0)
