from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad, trapezoid

from isacbench.errors import InputError
from isacbench.link.waveform.ofdm import layout, modulate, n_samples, transmit_window
from isacbench.link.waveform.power_spectrum import (
    mean_power,
    measured_density,
    occupied_bandwidth_hz,
    out_of_band_db,
    power_density,
    window_spectrum,
)
from isacbench.link.waveform.qam import constellation
from isacbench.model.numerology import System

SPACING_HZ = 240e3


def a_system(n_subcarriers=16, n_symbols=8, prefix=1 / 4, suffix=1 / 8):
    return System(
        n_subcarriers=n_subcarriers,
        n_symbols=n_symbols,
        cyclic_prefix_ratio=prefix,
        cyclic_suffix_ratio=suffix,
    )


RATIOS = [(1 / 4, 1 / 8), (1 / 4, 1 / 4), (1 / 4, 0.0), (0.0, 0.0), (1.0, 0.5)]


@pytest.mark.parametrize(("prefix", "suffix"), RATIOS)
def test_the_closed_form_is_the_fourier_transform_of_the_transmit_window(prefix, suffix):
    system = a_system(prefix=prefix, suffix=suffix)
    parts = layout(system)
    n = parts.n_useful
    start, stop = -parts.n_prefix, n + parts.n_suffix
    middle = (start + stop) / 2
    # At 1/(2 T_CS) the quotient of the closed form is 0/0.
    for turns in (0.0, 0.3, 1.0, 0.5 / (suffix or 1), 2.7, -5.2):
        expected, _ = quad(
            lambda k, turns=turns: (
                float(transmit_window(parts, k)) * np.cos(2 * np.pi * turns * (k - middle) / n)
            ),
            start,
            stop,
            points=[start + parts.n_suffix, n],
            limit=200,
        )
        found = window_spectrum(system, turns * SPACING_HZ) * SPACING_HZ
        assert found == pytest.approx(expected / n, abs=1e-9)


@pytest.mark.parametrize(("prefix", "suffix"), RATIOS)
def test_the_density_integrates_to_the_mean_power(prefix, suffix):
    system = a_system(prefix=prefix, suffix=suffix)
    spacings = np.arange(-600, 616, 1 / 16)
    power = trapezoid(power_density(system, spacings * SPACING_HZ), spacings * SPACING_HZ)
    # The far sidelobes of a rectangle hold 1/(π² x) T/T_OFDM of the power beyond x spacings.
    beyond = 1 / (np.pi**2 * 600 * (1 + prefix)) if suffix == 0 else 0.0
    assert power + beyond == pytest.approx(mean_power(system), abs=4e-6)


@pytest.mark.parametrize(("prefix", "suffix"), RATIOS)
def test_the_mean_power_is_that_of_the_windows_of_successive_symbols(prefix, suffix):
    system = a_system(prefix=prefix, suffix=suffix)
    parts = layout(system)
    places = (np.arange(10**4) + 0.5) * parts.n_symbol / 10**4
    squares = sum(transmit_window(parts, places - m * parts.n_symbol) ** 2 for m in (-1, 0, 1))
    assert squares.mean() == pytest.approx(mean_power(system), abs=1e-4)


def test_in_the_middle_of_a_wide_band_the_prefix_makes_the_known_ripple():
    # Poisson's sum over all subcarriers: what repeats after T interferes with itself.
    system = a_system(n_subcarriers=4096, suffix=0.0)
    place = 2048 + np.linspace(0, 1, 9)
    expected = 1 + 2 * (1 / 4) / (5 / 4) * np.cos(2 * np.pi * place)
    found = power_density(system, place * SPACING_HZ) * system.bandwidth_hz
    np.testing.assert_allclose(found, expected, rtol=3e-4)


def periodogram_mean(system, oversampling, frequency_hz):
    """Mean periodogram of a frame by sums over the samples of the window."""
    parts = layout(system, oversampling)
    rate_hz = oversampling * system.bandwidth_hz
    places = np.arange(-parts.n_prefix, parts.n_useful + parts.n_suffix)
    distance_hz = frequency_hz[:, None] - SPACING_HZ * np.arange(system.n_subcarriers)
    phase = np.exp(-2j * np.pi * distance_hz[..., None] * places / rate_hz)
    spectrum = (phase @ transmit_window(parts, places)) / rate_hz
    return np.sum(np.abs(spectrum) ** 2, axis=1) / (system.n_subcarriers * system.symbol_time_s)


@pytest.mark.parametrize("suffix", [0.0, 1 / 8])
def test_the_measured_density_has_the_mean_of_theory(suffix):
    system, oversampling, n_draws = a_system(suffix=suffix), 2, 800
    rng = np.random.default_rng(0)
    total = 0.0
    for _ in range(n_draws):
        symbols = rng.choice(constellation("16qam"), (16, 8))
        frequency_hz, density = measured_density(
            modulate(symbols, system, oversampling), system, oversampling, 1.0
        )
        total = total + density
    expected = periodogram_mean(system, oversampling, frequency_hz)
    # One bin of a frame is nearly exponential: as much deviation as mean.
    scaled = np.sqrt(n_draws) * (total / n_draws / expected - 1)
    assert np.abs(scaled).max() < 5
    assert 0.7 < scaled.std() < 1.3


def test_sampled_often_enough_the_density_is_the_closed_form():
    system = a_system(suffix=1 / 4)
    frequency_hz = np.linspace(-20, 36, 71) * SPACING_HZ
    found = periodogram_mean(system, 32, frequency_hz)
    np.testing.assert_allclose(found, power_density(system, frequency_hz), rtol=0.02)


def test_a_measured_density_integrates_to_the_energy_of_the_waveform():
    system = a_system()
    rng = np.random.default_rng(0)
    waveform = modulate(rng.choice(constellation("qpsk"), (16, 8)), system, 3)
    frequency_hz, density = measured_density(waveform, system, 3, 1.0)
    mean = np.sum(np.abs(waveform) ** 2) / (3 * system.bandwidth_hz) / (8 * system.symbol_time_s)
    assert density.sum() * (frequency_hz[1] - frequency_hz[0]) == pytest.approx(mean, rel=1e-12)


def test_measured_frequencies_lie_around_the_middle_of_the_band_and_count_from_subcarrier_0():
    system = a_system(n_symbols=64)
    symbols = np.zeros((16, 64))
    symbols[11] = np.random.default_rng(0).choice([-1, 1], 64)
    frequency_hz, density = measured_density(modulate(symbols, system, 4), system, 4, 20e3)
    assert abs(np.sum(frequency_hz * density) / np.sum(density) - 11 * SPACING_HZ) < 0.05 * SPACING_HZ
    assert frequency_hz.mean() == pytest.approx(7.5 * SPACING_HZ, abs=20e3)
    assert np.ptp(frequency_hz) == pytest.approx(4 * system.bandwidth_hz, rel=0.01)
    assert np.diff(frequency_hz)[0] == pytest.approx(20e3, rel=0.1)


def test_a_suffix_window_clears_what_lies_beside_the_band():
    windowed = System()
    offsets_hz = SPACING_HZ * np.array([1, 10, 100, 1000])
    plain_db = out_of_band_db(replace(windowed, cyclic_suffix_ratio=0.0), offsets_hz)
    gain_db = plain_db - out_of_band_db(windowed, offsets_hz)
    assert (gain_db > 0).all()
    # Far out a sidelobe falls with the square of its distance, and a windowed one with the sixth power
    # (half a sine wave, whose fast cosine averages to a half); sums over the subcarriers are integrals.
    near, far = offsets_hz[2:] / SPACING_HZ, offsets_hz[2:] / SPACING_HZ + 2048
    plain = 1 / near - 1 / far
    smoothed = 0.5 * 32**4 / 16 * (near**-5 - far**-5) / 5
    np.testing.assert_allclose(gain_db[2:], 10 * np.log10(plain / smoothed), atol=0.6)


def test_out_of_band_levels_are_means_over_a_spacing_and_alike_on_both_sides():
    system = a_system(n_subcarriers=64)
    offset_hz = 7.3 * SPACING_HZ
    middle_hz = 63.5 * SPACING_HZ + offset_hz
    around_hz = np.linspace(-0.5, 0.5, 4001) * SPACING_HZ
    for centre_hz in (middle_hz, 63 * SPACING_HZ - middle_hz):
        mean = trapezoid(power_density(system, centre_hz + around_hz), around_hz) / SPACING_HZ
        expected_db = 10 * np.log10(mean * system.bandwidth_hz / mean_power(system))
        assert out_of_band_db(system, offset_hz) == pytest.approx(expected_db, abs=1e-5)


@pytest.mark.parametrize("n_subcarriers", [1, 2, 16])
@pytest.mark.parametrize("suffix", [0.0, 1 / 8])
@pytest.mark.parametrize("share", [0.5, 0.99])
def test_the_occupied_bandwidth_holds_its_share(n_subcarriers, suffix, share):
    system = System(n_subcarriers=n_subcarriers, cyclic_suffix_ratio=suffix)
    width_hz = occupied_bandwidth_hz(system, share)
    frequency_hz = (n_subcarriers - 1) / 2 * SPACING_HZ + width_hz * np.linspace(-0.5, 0.5, 40001)
    inside = trapezoid(power_density(system, frequency_hz), frequency_hz)
    assert inside == pytest.approx(share * mean_power(system), rel=1e-6)


def test_of_a_wide_band_99_percent_is_about_99_percent_of_its_width():
    assert occupied_bandwidth_hz(System()) == pytest.approx(0.99 * System().bandwidth_hz, rel=1e-3)


@pytest.mark.parametrize("share", [0.0, 1.0, -1.0, np.nan])
def test_a_share_that_no_band_holds_is_refused(share):
    with pytest.raises(InputError, match="share"):
        occupied_bandwidth_hz(System(), share)


def test_a_density_is_measured_of_a_whole_frame_alone():
    system = a_system()
    n = n_samples(layout(system, 2), 8)
    with pytest.raises(InputError, match=rf"waveform of shape \({n - 1},\): allowed is \({n},\)"):
        measured_density(np.ones(n - 1), system, 2, 1e3)
    for resolution_hz in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="resolution_hz"):
            measured_density(np.ones(n), system, 2, resolution_hz)
