"""Fits of plane waves: slope and curvature against differences, and against plain algebra."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.fitting.maximum_likelihood import fit_waves, real_snapshots
from isacbench.model.kernels import steering
from tests.dsp.plane_wave_data import least_squares, noise

SHAPE = 7, 6
NUMBERS = ("unexplained", "gradient", "curvature", "hessian", "power", "alone")


@st.composite
def cells(draw):
    """Two cells of noise in two snapshots, up to three directions of each; one may be a filler."""
    rng = np.random.default_rng(draw(st.integers(0, 9999)))
    k = draw(st.integers(1, 3))
    data = noise(2, 2, *SHAPE, seed=rng)
    u = np.sort(rng.uniform(-0.2, 0.2, (2, k)), axis=1) + 0.6 * (np.arange(k) - 1)
    w = rng.uniform(-0.8, 0.8, (2, k))
    found = np.ones((2, k), dtype=bool)
    found[1, -1] = k == 1 or draw(st.booleans())
    return data, u, w, found


@pytest.mark.parametrize("seed", range(4))
def test_slope_and_curvature_are_those_of_the_unexplained_power(seed):
    rng = np.random.default_rng(seed)
    data = noise(1, 2, *SHAPE, seed=rng)
    places, found = rng.uniform(-0.8, 0.8, (1, 6)), np.ones((1, 3), dtype=bool)

    def fit(places):
        return fit_waves(real_snapshots(data), places[:, :3], places[:, 3:], found)

    here, step = fit(places), 1e-5
    for k in range(6):
        there, back = (fit(places + sign * step * (np.arange(6) == k)) for sign in (1, -1))
        slope = -(there.unexplained - back.unexplained) / (4 * step)
        np.testing.assert_allclose(here.gradient[:, k], slope, atol=1e-6 * np.abs(here.gradient).max())
        bend = -(there.gradient - back.gradient) / (2 * step)
        np.testing.assert_allclose(here.hessian[:, k], bend, atol=1e-6 * np.abs(here.hessian).max())


@given(cell=cells())
def test_what_is_left_is_what_plain_least_squares_leaves(cell):
    data, u, w, found = cell
    fit = fit_waves(real_snapshots(data), u, w, found)
    for n in range(2):
        _, left = least_squares(data[n], u[n][found[n]], w[n][found[n]])
        assert fit.unexplained[n] == pytest.approx(left, rel=1e-9)


def test_coinciding_waves_share_their_amplitude_and_fillers_have_none():
    data = np.outer(steering(8, 0.1), steering(8, 0.2))[None, None]
    u, w = np.array([[0.1, 0.1, 0.5]]), np.array([[0.2, 0.2, 0.5]])
    fit = fit_waves(real_snapshots(data), u, w, np.array([[True, True, False]]))
    assert all(np.isfinite(getattr(fit, name)).all() for name in NUMBERS)
    assert fit.unexplained[0] < 1e-12 * np.sum(np.abs(data) ** 2)
    assert fit.power[0, 2] == 0
