"""The range-Doppler map: unitary, signed as the convention says, of the grid's precision."""

import cmath

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from isacbench.dsp.angles.aperture import Cross, Plane
from isacbench.dsp.rangedoppler import GatedMap, range_doppler_map
from isacbench.dsp.windows import COEFFICIENTS, reach, taper
from isacbench.errors import InputError
from isacbench.model.gate import Gate
from tests.dsp.plane_wave_data import noise

SIZES = st.integers(1, 9)


@given(SIZES, SIZES)
def test_the_map_is_the_double_sum_it_stands_for(n_subcarriers, n_symbols):
    grid = noise(n_subcarriers, n_symbols)
    cells = range_doppler_map(grid)
    for r, d in np.ndindex(grid.shape):
        turns = {(n, m): n * r / n_subcarriers - m * d / n_symbols for n, m in np.ndindex(grid.shape)}
        total = sum(grid[place] * cmath.exp(2j * cmath.pi * turn) for place, turn in turns.items())
        assert cells[r, d] == pytest.approx(total / grid.size**0.5, abs=1e-12)


@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
def test_the_map_keeps_precision_and_leaves_the_grid_alone(dtype):
    grid = noise(6, 4).astype(dtype)
    grid.setflags(write=False)
    assert range_doppler_map(grid).dtype == dtype


def test_a_tapered_map_keeps_cells_bins_and_reachable_ones_together():
    cells = noise(12, 20, 2, 3)
    gate = Gate(np.arange(40, 52), np.arange(-10, 10), slice(4, 9), slice(6, 15))
    tapered = GatedMap(cells, gate).tapered("hann", "blackman")
    expected = taper(taper(cells, "hann", 0), "blackman", 1)
    assert_allclose(tapered.cells, expected, rtol=1e-12)
    assert_allclose(np.concatenate([*tapered.blocks()]), expected, rtol=1e-12)
    part = slice(2, None), slice(3, 9)
    assert_allclose(np.concatenate([*tapered.blocks(part)]), expected[part], rtol=1e-12)
    rows, columns = np.array([[8], [1], [3]]), np.array([[14], [1], [4]])
    expected = expected[rows + np.array([0, -1, 1, 0, 0]), columns + np.array([0, 0, 0, -1, 1])]
    assert_allclose(tapered.around((rows[:, 0] + 41, columns[:, 0] - 8)), expected, rtol=1e-12)
    none = np.empty(0, dtype=int)
    assert tapered.around((none, none)).shape == (0, 5, 2, 3)
    assert tapered.gate.shape == tapered.cells.shape[:2] == (10, 16)
    np.testing.assert_array_equal(tapered.gate.reachable, gate.reachable[1:-1, 2:-2])
    assert tapered.aperture == Plane(2, 3)


@pytest.mark.parametrize("given", [np.complex64, np.complex128])
@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
def test_a_tapered_map_has_the_precision_that_is_asked_for_and_keeps_all_else(given, dtype):
    gate = Gate(np.arange(12), np.arange(20), slice(0, 12), slice(0, 20))
    gated = GatedMap(noise(12, 20, 4).astype(given), gate, Cross(2, 3))
    tapered = gated.tapered("hann", "soft", dtype=dtype)
    around = tapered.around((np.array([5]), np.array([9])))
    assert (tapered.cells.dtype, around.dtype, tapered.aperture) == (dtype, dtype, Cross(2, 3))
    double = GatedMap(gated.cells.astype(np.complex128), gate, Cross(2, 3)).tapered("hann", "soft")
    assert_allclose(tapered.cells, double.cells, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("window", COEFFICIENTS)
@pytest.mark.parametrize("n", [5, 6, 7, 16, 31])
def test_a_whole_axis_is_tapered_as_the_window_times_the_grid_and_loses_no_bin(window, n):
    grid, first = noise(n, 4, 2, 2), -n // 3
    phase = 2 * np.pi * np.arange(n) / n
    weights = sum((-1) ** k * a * np.cos(k * phase) for k, a in enumerate(COEFFICIENTS[window]))
    weights = weights / np.sqrt(np.mean(weights**2))
    shifted = np.roll(range_doppler_map(grid), -first, axis=0)
    expected = np.roll(range_doppler_map(grid * weights[:, None, None, None]), -first, axis=0)
    gate = Gate(np.arange(first, first + n), np.arange(4), slice(1, n), slice(0, 4), (True, False))
    tapered = GatedMap(shifted, gate).tapered(window, "rect")
    np.testing.assert_array_equal(tapered.gate.range_bins, gate.range_bins)
    np.testing.assert_array_equal(tapered.gate.reachable, gate.reachable)
    assert_allclose(tapered.cells, expected, atol=1e-12)


def test_a_whole_axis_repeats_its_far_end_as_neighbours():
    gate = Gate(np.arange(-4, 4), np.arange(12), slice(0, 8), slice(2, 9), (True, False))
    gated = GatedMap(noise(8, 12, 2, 2), gate)
    tapered = gated.tapered("hann", "hann", neighbours=1)
    assert tapered.gate.range_bins.tolist() == list(range(-5, 5))
    assert tapered.gate.doppler_bins.tolist() == list(range(1, 11))
    np.testing.assert_array_equal(tapered.cells[[0, -1]], tapered.cells[[-2, 1]])
    assert tapered.gate.surrounds((np.arange(-4, 4), np.full(8, 5))).all()
    rows, columns = tapered.gate.index((np.array([-4, 3]), np.array([1, 5])))
    assert (rows.tolist(), columns.tolist()) == ([1, 8], [0, 4])


@pytest.mark.parametrize("window", [window for window in COEFFICIENTS if window != "rect"])
def test_an_axis_with_fewer_bins_than_the_window_has_taps_is_refused_even_where_it_is_whole(window):
    n = 2 * reach(window)
    gate = Gate(np.arange(n), np.arange(9), slice(0, n), slice(0, 9), (True, False))
    with pytest.raises(InputError, match=f"takes at least {n + 1} neighbouring bins; the gate has {n}"):
        GatedMap(noise(n, 9, 1, 1), gate).tapered(window, "rect")
