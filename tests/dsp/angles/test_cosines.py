"""Direction cosines on their circle of period 2: samples, and peaks across its ends."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.angles.peaks import cosine_samples, with_neighbours
from isacbench.dsp.angles.planar_subspaces import null_minima, planar_eigenpairs
from isacbench.dsp.fitting.maximum_likelihood import resolve_directions
from isacbench.model.kernels import PERIOD, within_period
from tests.dsp.plane_wave_data import pairs_of, snapshot, waves


def test_a_cosine_and_that_two_farther_are_one():
    np.testing.assert_allclose(within_period(np.array([-1.02, 0.98, 0.3, 2.3])), [0.98, 0.98, 0.3, 0.3])
    np.testing.assert_allclose(within_period(np.array([-0.6, 0.3, 1.4]), 0.9), [1.4, 0.3, 1.4])
    assert pairs_of(waves(1.25, -1.5)) == [(-0.75, 0.5)]


def test_samples_reach_one_step_beyond_the_limits():
    samples = cosine_samples((-0.3, 0.4), 0.11)
    assert samples[1] == pytest.approx(-0.3)
    assert samples[-2] == pytest.approx(0.4)
    assert len(cosine_samples((0.1, 0.1), 0.11)) > 2
    assert np.ptp(np.diff(samples)) < 1e-12
    assert np.diff(samples).max() <= 0.11 + 1e-12


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(0.005, 0.5))
def test_no_sample_is_there_twice_and_all_limits_lie_between_samples(one, other, widest):
    lower, upper = sorted((one, other))
    samples = cosine_samples((lower, upper), widest)
    _, (framed,) = with_neighbours(np.zeros((1, samples.size)), [samples])
    assert np.diff(samples).max() <= widest * (1 + 1e-9)
    # Peaks are sought at the samples that have a neighbour on either side.
    assert framed[-2] - framed[1] < PERIOD - 1e-9
    assert framed[0] < lower
    assert framed[-1] > upper


@pytest.mark.parametrize("w", [0.0, 1.0])
@pytest.mark.parametrize("u", [0.97, 0.99, 1.0, -0.99, -0.97, 0.955])
def test_a_null_at_the_ends_of_the_circle_is_found_once(u, w):
    basis = planar_eigenpairs(snapshot([u], [w], [1.0], (8, 8))[None], (4, 4), 1).vectors.reshape(1, 4, 4, 1)
    grid = cosine_samples((-1.0, 1.0), 4 / (4 * 16))
    found = null_minima(basis, grid, grid, np.array([4]))
    np.testing.assert_allclose(within_period(found.place - [[u, w]]), [[0, 0]], atol=1e-9)


def test_two_starts_on_either_end_of_the_circle_become_the_one_wave_between_them():
    noisy = snapshot([1.0], [0.0], [1.0], (8, 8))[:, None]
    found = resolve_directions(noisy, waves([0.999, -0.998], [0, 0]), 1e-3, 1e-3, 10)
    assert within_period(found.u[found.found] - 1.0) == pytest.approx([0], abs=1e-3)
