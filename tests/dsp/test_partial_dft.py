"""Partial transforms: the same cells as the whole transforms, whatever the blocks."""

from itertools import product

import numpy as np
import pytest
import scipy.fft
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.partial_dft import (
    doppler_rows,
    doppler_sums,
    is_element_major,
    range_bins_by_fft,
    range_method,
    range_rows,
    transform_block,
    transform_lines,
    with_few_elements_outermost,
)
from isacbench.dsp.rangedoppler import range_doppler_map
from tests.dsp.plane_wave_data import noise

sizes = st.integers(1, 24)


@given(n=sizes, bins=st.lists(st.integers(-50, 50), min_size=1, max_size=6))
def test_rows_are_those_of_the_unitary_dft_for_bins_of_either_sign(n, bins):
    for rows, transform in ((range_rows, scipy.fft.ifft), (doppler_rows, scipy.fft.fft)):
        expected = transform(np.eye(n), axis=0, norm="ortho")[np.array(bins) % n]
        np.testing.assert_allclose(rows(bins, n), expected, atol=1e-14)


def test_rows_keep_their_digits_at_the_last_bin_of_a_long_transform():
    exact = np.exp(2j * np.pi * ((2047 * 2047) % 2048) / 2048) / np.sqrt(2048)
    assert abs(range_rows([2047], 2048)[0, 2047] - exact) < 1e-17


@given(data=st.data(), n=sizes, m=sizes, e=st.integers(1, 5))
def test_cells_of_a_gate_are_those_of_the_whole_map_whatever_the_memory_order(data, n, m, e):
    grid = noise(n, m, e, seed=n + 100 * m)
    order = data.draw(st.permutations(range(3)))
    stored = np.ascontiguousarray(grid.transpose(order)).transpose(np.argsort(order))
    range_bins = np.arange(data.draw(st.integers(1, n))) - 2
    doppler_bins = np.arange(data.draw(st.integers(1, m))) - 1
    expected = range_doppler_map(grid)[np.ix_(range_bins % n, doppler_bins % m)]
    cells = transform_block(stored, doppler_rows(doppler_bins, m), range_rows(range_bins, n))
    np.testing.assert_allclose(cells, expected, atol=1e-12)


@given(data=st.data(), n=st.integers(2, 20), m=st.integers(2, 20))
def test_cells_are_the_sum_over_any_blocks_of_the_grid(data, n, m):
    grid = noise(n, m, 3, seed=n * m)
    along_doppler, along_range = doppler_rows([0, 1], m), range_rows([0, 1, 2], n)
    parts = [np.split(np.arange(size), [data.draw(st.integers(1, size - 1))]) for size in (n, m)]
    total = sum(
        transform_block(grid[np.ix_(rows, columns)], along_doppler[:, columns], along_range[:, rows])
        for rows, columns in product(*parts)
    )
    np.testing.assert_allclose(total, transform_block(grid, along_doppler, along_range), atol=1e-12)


@given(st.lists(st.integers(-30, 30), min_size=1, max_size=12, unique=True), sizes, st.sampled_from("CF"))
def test_sums_yield_the_doppler_bins_whatever_bins_have_their_opposite(bins, m, order):
    grid = np.asarray(noise(6, m, 3, seed=m), order=order)
    sums = doppler_sums(bins, m)
    found = sums.bins(transform_block(grid, sums.rows_in(np.complex128), range_rows([0, 1], 6)))
    expected = transform_block(grid, doppler_rows(bins, m), range_rows([0, 1], 6))
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_gate_of_both_signs_takes_real_sums_and_one_of_a_single_sign_does_not():
    assert doppler_sums(range(-16, 17), 224).rows_in(np.complex64).dtype == np.float32
    assert doppler_sums(range(5, 20), 224).rows_in(np.complex64).dtype == np.complex64


def test_range_bins_by_fft_are_those_by_rows():
    grid = noise(40, 6, 2, seed=1)
    bins = np.arange(-3, 17)
    at_doppler = transform_block(grid, doppler_rows([0, 1, 2], 6))
    expected = transform_block(grid, doppler_rows([0, 1, 2], 6), range_rows(bins, 40))
    np.testing.assert_allclose(range_bins_by_fft(at_doppler, bins), expected, atol=1e-12)


@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
def test_whole_lines_have_the_cells_of_any_block(dtype):
    grid = np.asarray(noise(40, 6, 3, seed=3), dtype, order="F")
    bins, sums = np.arange(-3, 17), doppler_sums(range(-2, 3), 6)
    found = transform_lines(grid, sums.rows_in(dtype), bins)
    expected = transform_block(grid, sums.rows_in(dtype), range_rows(bins, 40))
    np.testing.assert_allclose(found, expected, atol=1e-5 if dtype is np.complex64 else 1e-12)
    assert found.dtype == np.complex128


@pytest.mark.parametrize("shape", [(40, 6, 3), (40, 6, 20), (2, 6, 3), (1, 1, 1)])
@pytest.mark.parametrize("order", ["C", "F"])
def test_moving_few_elements_outermost_changes_no_number(shape, order):
    grid = np.asarray(noise(*shape, seed=4), order=order)
    moved = with_few_elements_outermost(grid)
    assert np.array_equal(moved, grid)
    assert is_element_major(moved) == ((order == "F" and min(shape) > 1) or shape == (40, 6, 3))


@pytest.mark.parametrize("order", ["C", "F"])
def test_single_precision_stays_single_and_errs_by_its_rounding(order):
    grid = np.asarray(noise(512, 56, 4, seed=2), np.complex64, order)
    rows = doppler_rows(range(-8, 9), 56), range_rows(range(100, 160), 512)
    cells = transform_block(grid, *(each.astype(np.complex64) for each in rows))
    assert cells.dtype == np.complex64
    exact = transform_block(grid.astype(np.complex128), *rows)
    assert np.sqrt(np.mean(np.abs(cells - exact) ** 2) / np.mean(np.abs(exact) ** 2)) < 1e-6


@given(n=st.integers(1, 4096), lines=st.sampled_from(["contiguous", "strided"]))
def test_an_fft_takes_over_where_bins_are_many_and_never_goes_back(n, lines):
    methods = [range_method(bins, n, lines) for bins in range(1, n + 1)]
    assert methods == sorted(methods, reverse=True)
