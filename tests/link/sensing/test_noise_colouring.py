"""Coloured noise: its covariance is that of weighted noise on the resource grid, to the last digit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from isacbench.dsp.partial_dft import doppler_rows, range_rows
from isacbench.link.sensing import noise_colouring
from isacbench.link.sensing.division import division_weights
from isacbench.link.sensing.noise_colouring import coloured_noise, noise_covariance
from isacbench.model.echo import random_stream, white_gaussian
from isacbench.model.numerology import System, prs_elements


def exact_covariance(weight, shape):
    """Covariance of all cells of a gate, from the transform of the resource grid's noise."""
    rows = np.kron(range_rows(range(shape[0]), len(weight)), doppler_rows(range(shape[1]), weight.shape[1]))
    return (rows * weight.ravel() ** 2) @ rows.conj().T


class Tracer:
    """Stands in for random numbers: of all that are drawn, each element gets another one as 1, all else 0."""

    def __init__(self):
        self.torus, self.n_elements_done, self.n_numbers = None, 0, 0

    def __call__(self, stream, size):
        numbers = np.zeros(size, dtype=complex)
        if len(size) == 3:  # elements, torus
            self.torus, self.n_numbers = size[1:], size[1] * size[2]
            for element, field in enumerate(numbers.reshape(size[0], -1), self.n_elements_done):
                field[element : element + 1] = 1
            self.n_elements_done += size[0]
        else:  # numbers, elements
            for number, of_elements in enumerate(numbers, self.n_numbers):
                of_elements[number : number + 1] = 1
            self.n_numbers += size[0]
        return numbers


def made_covariance(weight, shape, monkeypatch):
    """Covariance that coloured noise has: products of the linear map from all numbers that it is made of."""
    n_cells = int(np.prod(shape))
    silent = Tracer()
    monkeypatch.setattr(noise_colouring, "white_gaussian", lambda stream, size: 0 * silent(stream, size))
    # Every cell of the gate's white noise in turn, as elements of one array.
    white = np.eye(n_cells, dtype=complex).reshape(*shape, n_cells, 1)
    of_white = coloured_noise(white, weight, None).reshape(n_cells, n_cells)
    total = of_white @ of_white.conj().T
    if silent.n_numbers:
        monkeypatch.setattr(noise_colouring, "white_gaussian", Tracer())
        silence = np.zeros((*shape, silent.n_numbers, 1), dtype=complex)
        of_fresh = coloured_noise(silence, weight, None).reshape(n_cells, -1)
        total += of_fresh @ of_fresh.conj().T
    n_on_grid = silent.n_numbers - int(np.prod(silent.torus)) if silent.torus else 0
    return total, silent.torus, n_on_grid


def weights_of(kind, n_subcarriers, n_symbols):
    """Noise weights: of the PRS, or of symbols whose power varies little or much."""
    if kind == "prs":
        mask = prs_elements(System(n_subcarriers=n_subcarriers, n_symbols=n_symbols))
        return division_weights(mask * 1.0, "reciprocal").noise
    rng = np.random.default_rng([n_subcarriers, n_symbols])
    strongest = {"slight": 1.1, "strong": 8.0}[kind]
    return np.where(rng.random((n_subcarriers, n_symbols)) < 0.05, strongest, 1.0)


@pytest.mark.parametrize(
    ("kind", "grid", "shape", "torus"),
    [
        ("slight", (40, 21), (5, 4), (9, 7)),
        ("slight", (12, 9), (12, 9), (12, 9)),
        ("strong", (40, 21), (5, 4), (9, 7)),
        ("strong", (12, 9), (12, 9), (12, 9)),
        ("strong", (12, 9), (12, 8), (12, 9)),
        ("prs", (32, 28), (7, 5), None),
        ("prs", (32, 14), (1, 6), None),
        ("prs", (8, 14), (6, 5), (8, 14)),
    ],
)
def test_the_covariance_is_that_of_the_resource_grid_to_rounding(kind, grid, shape, torus, monkeypatch):
    weight = weights_of(kind, *grid)
    made, used, n_on_grid = made_covariance(weight, shape, monkeypatch)
    np.testing.assert_allclose(made, exact_covariance(weight, shape), atol=1e-12 * np.mean(weight**2))
    assert used == torus
    # Strong elements that no small torus holds are drawn on the grid, and they alone.
    is_split = kind == "strong" and torus != grid
    assert n_on_grid == (np.sum(weight > 1) if is_split else 0)


@given(st.integers(1, 12), st.integers(1, 9), st.floats(0, 1), st.floats(0, 1), st.integers(0, 2**32 - 1))
@settings(derandomize=True)
def test_any_weights_and_gates_get_their_covariance(n, m, share_n, share_m, seed):
    rng = np.random.default_rng(seed)
    weight = rng.uniform(0, 2, (n, m)) * (rng.random((n, m)) < 0.8)
    weight[0, 0] = 1
    shape = 1 + int(share_n * (n - 1)), 1 + int(share_m * (m - 1))
    with pytest.MonkeyPatch.context() as monkeypatch:
        made, _, _ = made_covariance(weight, shape, monkeypatch)
    np.testing.assert_allclose(made, exact_covariance(weight, shape), atol=1e-11 * np.mean(weight**2))


@pytest.mark.parametrize("shape", [(4, 3), (16, 10), (16, 3), (1, 1)])
def test_equal_weights_leave_white_noise_as_it_is(shape):
    white = white_gaussian(random_stream("colour", 0, 0), (*shape, 2, 3))
    coloured = coloured_noise(white, np.ones((16, 10)), random_stream("colour", 0, 0, "more"))
    np.testing.assert_allclose(coloured, white, atol=1e-13)


def test_elements_get_independent_noise_of_the_right_power():
    weight = weights_of("slight", 64, 32)
    white = white_gaussian(random_stream("colour", 1, 0), (6, 5, 40, 50))
    cells = coloured_noise(white, weight, random_stream("colour", 1, 0, "more")).reshape(30, -1)
    sample = cells @ cells.conj().T / cells.shape[1]
    # 2000 elements: deviations of 1/sqrt(2000) an entry, five of them allowed.
    assert np.abs(sample - exact_covariance(weight, (6, 5))).max() < 5 / np.sqrt(2000)
    between = cells[:, :-1] * cells[:, 1:].conj()
    assert abs(between.mean()) < 5 / np.sqrt(between.size)


def test_covariance_of_the_prs_vanishes_between_ranges_of_a_street():
    covariance = noise_covariance(weights_of("prs", 2048, 224))
    assert np.abs(covariance[1:512]).max() < 1e-12 * covariance[0, 0].real
    assert abs(covariance[512, 56]) > 0.4 * covariance[0, 0].real
