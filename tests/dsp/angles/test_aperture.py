"""Elements of the array: every product as the double loop over elements has it, of plane and of cross."""

import cmath

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.angles.aperture import Cross, Plane
from isacbench.model.observation import cross_of

SHAPES = st.tuples(st.integers(1, 6), st.integers(1, 6))
SEEDS = st.integers(0, 9999)


def any_aperture(test):
    """Test planes and crosses of any shape, on any numbers."""
    return pytest.mark.parametrize("kind", [Plane, Cross])(given(shape=SHAPES, seed=SEEDS)(test))


def elements(aperture):
    """Places (p, q) of the elements, in the order in which snapshots hold them."""
    if isinstance(aperture, Plane):
        return [(p, q) for p in range(aperture.n_p) for q in range(aperture.n_q)]
    return [(p, 0) for p in range(aperture.n_p)] + [(0, q) for q in range(1, aperture.n_q)]


def response(aperture, u, w):
    """Phases of a unit wave at the elements, written out."""
    return np.array([cmath.exp(-1j * cmath.pi * (p * u + q * w)) for p, q in elements(aperture)])


def product(left, right):
    """Mean of conj(left) right over the elements, by a plain loop."""
    return sum(a.conjugate() * b for a, b in zip(left, right, strict=True)) / len(left)


def drawn(kind, shape, seed, *sizes):
    """Draw an aperture, cosines u and w of each size, and a source of random numbers."""
    rng = np.random.default_rng(seed)
    return kind(*shape), rng, *(rng.uniform(-1, 1, (2, *size)) for size in sizes)


def snapshots_of(aperture, rng, *leading):
    """Random snapshots."""
    axes = (aperture.n_p, aperture.n_q) if isinstance(aperture, Plane) else (aperture.n_elements,)
    parts = rng.standard_normal((2, *leading, *axes))
    return parts[0] + 1j * parts[1]


@given(shape=SHAPES, seed=SEEDS)
def test_a_cross_holds_its_elements_in_the_order_of_an_observation(shape, seed):
    plane, cross = Plane(*shape), Cross(*shape)
    cells = snapshots_of(plane, np.random.default_rng(seed), 3)
    picked = [[cells[n, p, q] for p, q in elements(cross)] for n in range(3)]
    np.testing.assert_array_equal(cross_of(cells), picked)


@any_aperture
def test_gram_matrices_are_the_products_of_all_pairs_of_responses(kind, shape, seed):
    aperture, _, (u, w) = drawn(kind, shape, seed, (2, 3))
    assert aperture.n_elements == len(elements(aperture))
    gram = aperture.towards(u, w).gram()
    for n, i, j in np.ndindex(2, 3, 3):
        pair = (response(aperture, u[n, k], w[n, k]) for k in (i, j))
        assert gram[n, i, j] == pytest.approx(product(*pair), abs=1e-12)
    np.testing.assert_allclose(aperture.towards(u[0], w[0]).gram(), gram[0], atol=1e-15)


@any_aperture
def test_gram_matrices_of_intersections_are_those_of_the_pairs_written_out(kind, shape, seed):
    aperture, _, (u, _), (_, w) = drawn(kind, shape, seed, (2, 3), (2, 2))
    gram = aperture.towards(u, w).intersections_gram().reshape(2, 6, 6)
    pairs = np.repeat(u, 2, axis=1), np.tile(w, (1, 3))
    np.testing.assert_allclose(gram, aperture.towards(*pairs).gram(), atol=1e-12)


@any_aperture
def test_matched_filters_are_the_products_of_responses_with_snapshots(kind, shape, seed):
    aperture, rng, (u, w) = drawn(kind, shape, seed, (2, 3))
    snapshots = snapshots_of(aperture, rng, 4, 2)
    matched = aperture.towards(u, w).matched(snapshots)
    assert matched.shape == (4, 2, 3)
    for s, n, k in np.ndindex(4, 2, 3):
        expected = product(response(aperture, u[n, k], w[n, k]), snapshots[s, n].ravel())
        assert matched[s, n, k] == pytest.approx(expected, abs=1e-12)


@any_aperture
def test_responses_about_the_middle_have_the_products_of_their_gram_matrix(kind, shape, seed):
    aperture, _, (u, w) = drawn(kind, shape, seed, (3,))
    responses, gram = aperture.towards(u, w).about_middle()
    np.testing.assert_allclose(responses.conj() @ responses.T / aperture.n_elements, gram, atol=1e-12)
    # The same as at their corner but for a phase each.
    at_corner = np.array([response(aperture, *one) for one in zip(u, w, strict=True)])
    np.testing.assert_allclose(np.abs(np.vecdot(at_corner, responses)), aperture.n_elements)


def test_responses_about_the_middle_keep_their_sign_where_last_digits_of_a_cosine_differ():
    # The phase of the last element is then half a turn, whose root has either sign.
    u = np.array([0.2]) + np.array([-1e-12, 0, 1e-12])
    responses, _ = Plane(16, 16).towards(u, u[::-1]).about_middle()
    np.testing.assert_allclose(responses, responses[[1, 1, 1]], atol=1e-9)


@any_aperture
def test_filters_of_intersections_are_those_of_the_pairs_written_out(kind, shape, seed):
    aperture, rng, (u, _), (_, w) = drawn(kind, shape, seed, (2, 3), (2, 2))
    snapshots = snapshots_of(aperture, rng, 2)
    pairs = np.repeat(u, 2, axis=1), np.tile(w, (1, 3))
    expected = aperture.towards(*pairs).matched(snapshots[None])[0].reshape(2, 3, 2)
    np.testing.assert_allclose(aperture.towards(u, w).matched_intersections(snapshots), expected, atol=1e-12)


@any_aperture
def test_a_synthesis_is_the_sum_of_waves_at_every_element(kind, shape, seed):
    aperture, rng, (u, w) = drawn(kind, shape, seed, (2, 3))
    amplitude = rng.standard_normal((2, 3)) + 1j * rng.standard_normal((2, 3))
    waves = aperture.towards(u, w).synthesis(amplitude)
    for n in range(2):
        expected = sum(amplitude[n, k] * response(aperture, u[n, k], w[n, k]) for k in range(3))
        np.testing.assert_allclose(waves[n].ravel(), expected, atol=1e-12)


@any_aperture
def test_lines_run_along_u_and_along_w_all_of_a_plane_and_one_each_of_a_cross(kind, shape, seed):
    aperture, _, (u, w) = drawn(kind, shape, seed, (2, 1))
    along_u, along_w = aperture.lines(aperture.towards(u, w).synthesis(np.ones((2, 1), complex)))
    n_u, n_w = shape[::-1] if kind is Plane else (1, 1)
    assert along_u.shape == (2, shape[0], n_u)
    assert along_w.shape == (2, shape[1], n_w)
    # From sensor to sensor the phase turns by -π times the cosine, on every line.
    steps = [np.exp(-1j * np.pi * cosine)[:, :, None] for cosine in (u, w)]
    np.testing.assert_allclose(along_u[:, 1:], along_u[:, :-1] * steps[0], atol=1e-12)
    np.testing.assert_allclose(along_w[:, 1:], along_w[:, :-1] * steps[1], atol=1e-12)


@given(seed=SEEDS, n=st.integers(2, 8))
def test_four_corners_of_a_rectangle_of_directions_are_dependent_on_a_cross_and_not_on_a_plane(seed, n):
    u, w = np.random.default_rng(seed).uniform(-0.9, 0.9, (2, 1, 2))
    u[0, 1], w[0, 1] = u[0, 0] + 1 / n, w[0, 0] - 1 / n
    grams = (kind(n, n).towards(u, w).intersections_gram().reshape(4, 4) for kind in (Plane, Cross))
    assert [np.linalg.matrix_rank(gram, tol=1e-9, hermitian=True) for gram in grams] == [4, 3]
