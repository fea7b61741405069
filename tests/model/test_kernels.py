"""Kernels against the sums and transforms they stand for."""

import cmath

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.model.kernels import dirichlet, dirichlet_slopes, steering

LENGTHS = st.integers(1, 40)
PLACES = st.floats(-100, 100)


@given(LENGTHS, st.integers(-100, 100), PLACES)
def test_the_dirichlet_kernel_is_the_sum_it_stands_for(n, bin_, place):
    total = sum(cmath.exp(2j * cmath.pi * i * (bin_ - place) / n) for i in range(n))
    assert dirichlet([bin_], [place], n)[0, 0] == pytest.approx(total / n**0.5, abs=1e-10)


@given(st.integers(1, 16), st.lists(st.floats(-1, 1), max_size=3))
def test_steering_is_one_phase_step_an_element(n_elements, cosines):
    response = steering(n_elements, cosines)
    assert response.shape == (len(cosines), n_elements)
    for row, u in zip(response, cosines, strict=True):
        expected = [cmath.exp(-1j * cmath.pi * p * u) for p in range(n_elements)]
        np.testing.assert_allclose(row, expected, atol=1e-12)


def test_steering_keeps_the_shape_of_its_cosines_in_front():
    assert steering(5, 0.3).shape == (5,)
    assert steering(5, np.zeros((2, 3))).shape == (2, 3, 5)


DISTANCES = st.floats(-90, 90)


@given(LENGTHS, DISTANCES)
def test_the_centred_kernel_and_its_slopes_are_sums_over_the_aperture(n, distance):
    middle = [i - (n - 1) / 2 for i in range(n)]
    phase = [2 * cmath.pi * x / n for x in middle]
    value = sum(cmath.cos(rate * distance).real for rate in phase) / n
    slope = sum(-rate * cmath.sin(rate * distance).real for rate in phase) / n
    curvature = sum(-(rate**2) * cmath.cos(rate * distance).real for rate in phase) / n
    actual = [float(part) for part in dirichlet_slopes(distance, n)]
    # Sums over half-integers repeat with a change of sign, which rounding must not touch.
    assert actual == pytest.approx([value, slope, curvature], abs=1e-5)


@pytest.mark.parametrize("n", [2, 3, 16, 2047])
def test_the_series_at_the_peak_meets_the_quotients_beside_it(n):
    below, above = (np.array(dirichlet_slopes(x, n)) for x in (0.999999e-3, 1.000001e-3))
    np.testing.assert_allclose(below[1], above[1], rtol=1e-5)
    np.testing.assert_allclose(below[[0, 2]], above[[0, 2]], rtol=5e-7)


@given(st.integers(2, 3000), st.floats(1e-12, 0.1), st.integers(-3, 3))
def test_slopes_keep_their_digits_near_every_peak(n, distance, turns):
    # At whole turns alone is the distance itself exact.
    offset = 0.0 if turns else distance
    value, slope, curvature = dirichlet_slopes(turns * n + offset, n)
    second, fourth = (np.pi**2) * (1 - n**-2) / 3, np.pi**4 / 5
    sign = -1 if turns * (n - 1) % 2 else 1
    assert sign * value == pytest.approx(1 - second * offset**2 / 2, abs=fourth * offset**4)
    assert sign * slope == pytest.approx(-second * offset, rel=1e-5, abs=fourth * offset**3)
    assert sign * curvature == pytest.approx(-second, abs=fourth * offset**2 + 1e-5)
