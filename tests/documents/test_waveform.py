"""The closed forms that docs/scripts/waveform.py draws, against the waveform itself."""

import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import quad, trapezoid

from isacbench.link.waveform.ofdm import layout, modulate, transmit_window
from isacbench.link.waveform.qam import constellation
from isacbench.model.numerology import System

SPACING_HZ = 240e3
RATIOS = [(1 / 4, 1 / 8), (1 / 4, 1 / 4), (1 / 4, 0.0), (0.0, 0.0), (1.0, 0.5)]


@pytest.fixture(scope="module")
def script():
    root = Path(__file__).resolve().parents[2]
    return SimpleNamespace(**runpy.run_path(str(root / "docs" / "scripts" / "waveform.py")))


@pytest.fixture(params=RATIOS, ids=str)
def system(request):
    prefix, suffix = request.param
    return System(n_subcarriers=16, n_symbols=8, cyclic_prefix_ratio=prefix, cyclic_suffix_ratio=suffix)


def test_the_spectrum_of_a_subcarrier_is_the_fourier_transform_of_the_transmit_window(script, system):
    parts = layout(system)
    n = parts.n_useful
    start, stop = -parts.n_prefix, n + parts.n_suffix
    middle = (start + stop) / 2
    # At 1/(2 T_CS) the quotient of the closed form is 0/0.
    for turns in (0.0, 0.3, 1.0, 0.5 / (system.cyclic_suffix_ratio or 1), 2.7, -5.2):

        def windowed(k, turns=turns):
            return float(transmit_window(parts, k)) * np.cos(2 * np.pi * turns * (k - middle) / n)

        expected, _ = quad(windowed, start, stop, points=[start + parts.n_suffix, n], limit=200)
        found = script.window_spectrum(system, turns * SPACING_HZ) * SPACING_HZ
        assert found == pytest.approx(expected / n, abs=1e-9)


def test_the_density_integrates_to_the_mean_power_of_the_windows_of_successive_symbols(script, system):
    spacings = np.arange(-600, 616, 1 / 16)
    power = trapezoid(script.power_density(system, spacings * SPACING_HZ), spacings * SPACING_HZ)
    # The far sidelobes of a rectangle hold 1/(π² x) T/T_OFDM of the power beyond x spacings.
    if system.cyclic_suffix_ratio == 0:
        power += 1 / (np.pi**2 * 600 * (1 + system.cyclic_prefix_ratio))
    assert power == pytest.approx(script.mean_power(system), abs=4e-6)
    parts = layout(system)
    places = (np.arange(10**4) + 0.5) * parts.n_symbol / 10**4
    squares = sum(transmit_window(parts, places - m * parts.n_symbol) ** 2 for m in (-1, 0, 1))
    assert squares.mean() == pytest.approx(script.mean_power(system), abs=1e-4)


@pytest.mark.parametrize("oversampling", [1, 4])
def test_peaks_over_the_mean_power_are_those_of_the_waveform(script, oversampling):
    system = System(n_subcarriers=64, n_symbols=9)
    symbols = np.random.default_rng(0).choice(constellation("16qam"), (64, 9))
    parts = layout(system, oversampling)
    frame = modulate(symbols, system, oversampling)[: 9 * parts.n_symbol].reshape(9, -1)
    peak = np.max(np.abs(frame[:, parts.n_prefix :]) ** 2, axis=1)
    expected_db = 10 * np.log10(peak / np.mean(np.abs(symbols) ** 2))
    np.testing.assert_allclose(script.symbol_papr_db(symbols, oversampling), expected_db, atol=1e-10)


@pytest.mark.parametrize(("oversampling", "oversampled"), [(1, False), (8, True)])
def test_gaussian_samples_have_peaks_as_theory_says(script, oversampling, oversampled):
    symbols = np.random.default_rng(0).standard_normal((256, 1500, 2)) @ [1, 1j] / np.sqrt(2)
    papr_db = script.symbol_papr_db(symbols, oversampling)
    for level_db in (8.0, 9.0, 10.0):
        probability = script.papr_ccdf(level_db, 256, oversampled=oversampled)
        deviation = np.sqrt(probability * (1 - probability) / papr_db.size)
        assert abs(np.mean(papr_db > level_db) - probability) < 4 * deviation
