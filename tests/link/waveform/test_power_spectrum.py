import numpy as np
import pytest
from scipy.integrate import quad, trapezoid

from isacbench.link.waveform.ofdm import layout, mean_power, power_density, transmit_window, window_spectrum
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


def test_sampled_often_enough_the_density_is_the_closed_form():
    system = a_system(suffix=1 / 4)
    frequency_hz = np.linspace(-20, 36, 71) * SPACING_HZ
    found = periodogram_mean(system, 32, frequency_hz)
    np.testing.assert_allclose(found, power_density(system, frequency_hz), rtol=0.02)
