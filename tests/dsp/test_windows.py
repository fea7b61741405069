"""Windows as convolutions of the map, against windows on the grid."""

from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.windows import COEFFICIENTS, Window, fractional_bin, reach, taper, taps
from isacbench.errors import InputError
from tests.dsp.plane_wave_data import noise

WINDOWS = get_args(Window)
N = 224


def samples(window, n=N):
    """Periodic window on the grid, scaled to keep the power of white noise."""
    turn = 2 * np.pi * np.arange(n) / n
    values = sum((-1) ** k * a * np.cos(k * turn) for k, a in enumerate(COEFFICIENTS[window]))
    return values / np.sqrt(np.mean(values**2))


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize("transform", [np.fft.fft, np.fft.ifft])
@pytest.mark.parametrize("n", [16, 17])
def test_convolving_the_map_is_windowing_the_grid(window, transform, n):
    grid = noise(3, n, 2)
    windowed = transform(samples(window, n)[:, None] * grid, axis=1, norm="ortho")
    tapered = taper(transform(grid, axis=1, norm="ortho"), window, axis=1)
    np.testing.assert_allclose(tapered, windowed[:, reach(window) : n - reach(window)], atol=1e-12)


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize("axis", [0, 1, -1])
def test_tapering_along_an_axis_trims_it_by_the_reach_and_leaves_the_others(window, axis):
    cells = noise(9, 8, 7)
    cells.setflags(write=False)
    expected = np.apply_along_axis(lambda line: np.convolve(line, taps(window), "valid"), axis, cells)
    np.testing.assert_allclose(taper(cells, window, axis), expected, atol=1e-12)


def test_no_window_copies_nothing():
    cells = noise(4, 4)
    assert taper(cells, "rect", 0) is cells


@pytest.mark.parametrize("window", [name for name in WINDOWS if reach(name)])
def test_an_axis_shorter_than_the_window_is_refused(window):
    width = 2 * reach(window) + 1
    assert taper(noise(width, 2), window, 0).shape == (1, 2)
    message = f"window '{window}' takes at least {width} .*the gate has {width - 1}"
    with pytest.raises(InputError, match=message):
        taper(noise(width - 1, 2), window, 0)


@pytest.mark.parametrize("window", WINDOWS)
@given(offset=st.floats(0, 1), start=st.integers(3, N - 4))
def test_the_offset_of_an_echo_is_read_off_its_dft(window, offset, start):
    echo = samples(window) * np.exp(2j * np.pi * np.arange(N) * (start + offset) / N)
    amplitude = np.abs(np.fft.fft(echo))
    found = fractional_bin(amplitude[[start]], amplitude[[start + 1]], window)
    assert found == pytest.approx(offset, abs=1e-5)


@pytest.mark.parametrize("window", WINDOWS)
def test_the_offset_rises_with_the_ratio_from_nought_to_one(window):
    ratio = np.concatenate([[0.0], np.geomspace(1e-3, 1e6, 200)])
    offsets = fractional_bin(np.ones_like(ratio), ratio, window)
    assert (np.diff(offsets) >= 0).all()
    assert offsets[0] == 0
    assert offsets[-1] == pytest.approx(1, abs=1e-5)
    assert fractional_bin(np.ones(1), np.ones(1), window) == pytest.approx(0.5)


def test_the_offset_of_a_hann_window_has_a_closed_form():
    ratio = np.linspace(0.5, 2, 31)
    found = fractional_bin(np.ones_like(ratio), ratio, "hann")
    np.testing.assert_allclose(found, (2 * ratio - 1) / (ratio + 1), atol=1e-5)
