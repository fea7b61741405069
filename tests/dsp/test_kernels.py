"""Kernels against the sums and transforms they stand for."""

import cmath

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.kernels import dirichlet, steering

LENGTHS = st.integers(1, 40)
PLACES = st.floats(-100, 100)


@given(LENGTHS, st.integers(-100, 100), PLACES)
def test_the_dirichlet_kernel_is_the_sum_it_stands_for(n, bin_, place):
    total = sum(cmath.exp(2j * cmath.pi * i * (bin_ - place) / n) for i in range(n))
    assert dirichlet([bin_], [place], n)[0, 0] == pytest.approx(total / n**0.5, abs=1e-10)


@given(st.integers(1, 40), st.lists(PLACES, min_size=1, max_size=3))
def test_the_kernel_is_an_inverse_dft_and_its_conjugate_a_forward_one(n, places):
    phase = 2j * np.pi * np.outer(np.arange(n), places) / n
    kernel = dirichlet(np.arange(n), places, n)
    np.testing.assert_allclose(kernel, np.fft.ifft(np.exp(-phase), axis=0, norm="ortho"), atol=1e-10)
    np.testing.assert_allclose(kernel.conj(), np.fft.fft(np.exp(phase), axis=0, norm="ortho"), atol=1e-10)


@given(LENGTHS, PLACES)
def test_all_bins_together_hold_the_energy_of_the_exponential(n, place):
    assert np.sum(np.abs(dirichlet(np.arange(n), [place], n)) ** 2) == pytest.approx(n)


@given(LENGTHS, st.integers(-50, 50), PLACES, st.integers(-3, 3))
def test_bins_repeat_after_the_transform_length(n, bin_, place, turns):
    expected = dirichlet([bin_], [place], n)
    np.testing.assert_allclose(dirichlet([bin_ + turns * n], [place], n), expected, atol=1e-10)


@given(st.integers(1, 16), st.lists(st.floats(-1, 1), max_size=3))
def test_steering_is_one_phase_step_an_element(n_elements, cosines):
    response = steering(n_elements, cosines)
    assert response.shape == (len(cosines), n_elements)
    for row, u in zip(response, cosines, strict=True):
        np.testing.assert_allclose(
            row, [cmath.exp(-1j * cmath.pi * p * u) for p in range(n_elements)], atol=1e-12
        )


def test_steering_keeps_the_shape_of_its_cosines_in_front():
    assert steering(5, 0.3).shape == (5,)
    assert steering(5, np.zeros((2, 3))).shape == (2, 3, 5)
