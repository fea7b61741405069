import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.link.waveform.ofdm import (
    SymbolLayout,
    demodulate,
    layout,
    modulate,
    n_samples,
    transmit_window,
)
from isacbench.model.numerology import System
from tests.conftest import refusal


def a_system(n, m, n_prefix, n_suffix):
    ratios = {"cyclic_prefix_ratio": n_prefix / n, "cyclic_suffix_ratio": n_suffix / n}
    return System(n_subcarriers=n, n_symbols=m, **ratios)


@st.composite
def systems(draw):
    """Small systems of any size, odd ones too, from no prefix to one as long as the useful part."""
    n_subcarriers, n_symbols = draw(st.integers(1, 40)), draw(st.integers(1, 6))
    n_prefix = draw(st.integers(0, n_subcarriers))
    return a_system(n_subcarriers, n_symbols, n_prefix, draw(st.integers(0, n_prefix)))


def drawn(system, seed=0):
    rng = np.random.default_rng(seed)
    shape = system.n_subcarriers, system.n_symbols
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


def plain_modulation(symbols, system, oversampling=1):
    """Sum of windowed exponentials at every sample, one after the other."""
    parts = layout(system, oversampling)
    waveform = np.zeros(n_samples(parts, system.n_symbols), dtype=complex)
    for (n, m), symbol in np.ndenumerate(symbols):
        for k in range(waveform.size):
            position = k - m * parts.n_symbol - parts.n_prefix
            turns = n * position / parts.n_useful
            waveform[k] += transmit_window(parts, position) * symbol * np.exp(2j * np.pi * turns)
    return waveform / np.sqrt(system.n_subcarriers)


SMALL = [a_system(*sizes) for sizes in [(8, 3, 2, 1), (5, 2, 3, 3), (4, 3, 0, 0), (6, 1, 6, 4), (3, 2, 2, 0)]]


@pytest.mark.parametrize("system", SMALL)
@pytest.mark.parametrize("oversampling", [1, 3])
def test_the_waveform_is_the_sum_of_windowed_exponentials(system, oversampling):
    symbols = drawn(system)
    expected = plain_modulation(symbols, system, oversampling)
    np.testing.assert_allclose(modulate(symbols, system, oversampling), expected, rtol=0, atol=1e-12)


def test_the_round_trip_of_a_whole_frame_is_exact():
    system = System()
    symbols = np.asfortranarray(drawn(system))
    returned = demodulate(modulate(symbols, system), system)
    assert np.abs(returned - symbols).max() < 1e-12
    assert returned.flags.f_contiguous


@given(systems(), st.integers(1, 4))
def test_oversampling_reads_the_same_continuous_waveform_more_often(system, oversampling):
    symbols = drawn(system)
    n = n_samples(layout(system), system.n_symbols)
    often = modulate(symbols, system, oversampling)[::oversampling][:n]
    np.testing.assert_allclose(often, modulate(symbols, system), rtol=0, atol=1e-12)


@given(systems(), st.integers(-6400, 6400))
def test_windows_of_successive_symbols_sum_to_one(system, place_in_64ths):
    parts, place = layout(system), place_in_64ths / 64
    starts = parts.n_symbol * np.arange(-110, 111)
    assert transmit_window(parts, place - starts).sum() == pytest.approx(1, abs=1e-12)


def test_the_window_falls_as_the_complement_of_its_rise():
    parts = SymbolLayout(64, 16, 8)
    place = np.linspace(0, 8, 101)
    rise, fall = transmit_window(parts, place - 16), transmit_window(parts, place + 64)
    np.testing.assert_allclose(rise + fall, 1, atol=1e-15)
    np.testing.assert_allclose(rise, np.sin(np.pi * place / 16) ** 2, atol=1e-15)
    assert transmit_window(parts, [-16.1, 72.1]).tolist() == [0, 0]


@given(systems(), st.integers(0, 99), st.data())
def test_the_round_trip_is_exact_and_a_delay_within_the_undisturbed_prefix_a_phase_ramp(system, seed, data):
    parts, symbols = layout(system), drawn(system, seed)
    np.testing.assert_allclose(demodulate(modulate(symbols, system), system), symbols, rtol=0, atol=1e-12)
    n_late = data.draw(st.integers(0, parts.n_prefix - parts.n_suffix))
    late = np.concatenate([np.zeros(n_late), modulate(symbols, system)])
    ramp = np.exp(-2j * np.pi * np.arange(system.n_subcarriers) * n_late / system.n_subcarriers)
    np.testing.assert_allclose(demodulate(late, system), symbols * ramp[:, None], rtol=0, atol=1e-12)


def test_one_sample_more_than_the_undisturbed_prefix_disturbs():
    system = a_system(32, 3, 8, 2)
    symbols = drawn(system)
    ramp = np.exp(-2j * np.pi * np.arange(32) / 32)[:, None]
    waveform = modulate(symbols, system)
    received = {n: demodulate(np.concatenate([np.zeros(n), waveform]), system) for n in (6, 7, 8)}
    assert np.abs(received[6] - symbols * ramp**6).max() < 1e-12
    # The first sample of a rising prefix is 0, and of the suffix before it 1.
    for n in (7, 8):
        assert np.abs(received[n] - symbols * ramp**n).max() > 1e-2


def test_trailing_axes_are_demodulated_each():
    system = a_system(16, 3, 4, 2)
    waveforms = np.stack([modulate(drawn(system, seed), system) for seed in range(6)], axis=1)
    grid = demodulate(waveforms.reshape(-1, 2, 3), system)
    assert grid.shape == (16, 3, 2, 3)
    for seed in range(6):
        np.testing.assert_allclose(grid[:, :, seed // 3, seed % 3], drawn(system, seed), atol=1e-12)


def test_inputs_are_left_alone():
    system = a_system(16, 3, 4, 2)
    symbols = np.asfortranarray(drawn(system))
    waveform = modulate(symbols, system)
    for array, function in ((symbols, modulate), (waveform, demodulate)):
        before = array.copy()
        array.setflags(write=False)
        function(array, system)
        assert np.array_equal(array, before)


def test_parts_of_no_whole_samples_are_refused():
    for (n, n_prefix, n_suffix), ratio in (
        *(((16, 16 / 5, 0), "prefix"), ((16, 4, 1 / 4), "suffix"), ((10, 10 / 3, 0), "prefix")),
    ):
        message = refusal(layout, a_system(n, 3, n_prefix, n_suffix))
        assert re.search(f"cyclic_{ratio}_ratio.*whole number of samples over the {n}", message)


def test_ratios_are_rounded_to_samples_and_oversampling_may_make_samples_whole():
    assert layout(a_system(30, 3, 10, 3)) == SymbolLayout(30, 10, 3)
    assert layout(a_system(16, 3, 4, 0.5), 2) == SymbolLayout(32, 8, 1)


def test_other_parts_oversamplings_and_shapes_are_refused():
    message = "cyclic_suffix_ratio = 0.5: allowed is up to cyclic_prefix_ratio 0.25"
    assert message in refusal(layout, System(cyclic_suffix_ratio=0.5))
    for oversampling in (0, -1, 1.5, True):
        assert "oversampling" in refusal(layout, System(), oversampling)
    for shape in ((8,), (3, 8), (8, 4), (8, 3, 1)):
        message = refusal(modulate, np.ones(shape), SMALL[0])
        assert f"symbols of shape {shape}" in message
        assert "allowed is (8, 3)" in message
    for shape in ((), (29,), (0,), (2, 30)):
        assert "allowed are 30 samples or more" in refusal(demodulate, np.ones(shape), SMALL[0])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, complex(0, np.nan)])
def test_what_is_not_finite_is_refused_wherever_it_is(value):
    for place in np.ndindex(8, 3):
        symbols = np.ones((8, 3), dtype=complex)
        symbols[place] = value
        assert "symbols hold values that are not finite" in refusal(modulate, symbols, SMALL[0])
    for place in range(20, 30):
        waveform = np.ones(30, dtype=complex)
        waveform[place] = value
        if place < 22:  # of a prefix nothing is read
            assert np.isfinite(demodulate(waveform, SMALL[0])).all()
        else:
            assert "waveform holds values that are not finite" in refusal(demodulate, waveform, SMALL[0])
