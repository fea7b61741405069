"""Model orders: known eigenvalues and sources, and noise that is not to pass for any."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.angles.model_order import (
    eigenvalue_cfar_order,
    information_order,
    noise_edge,
    noise_order,
    smoothed_noise_edge,
)
from isacbench.dsp.angles.planar_subspaces import planar_covariance
from isacbench.dsp.cfar.factors import ca_factor
from isacbench.model.kernels import steering
from tests.dsp.plane_wave_data import noise


def eigenvalues_of(snapshots, subarray):
    """Descending eigenvalues of planar smoothed covariances."""
    return np.linalg.eigvalsh(planar_covariance(snapshots[:, None], subarray))[:, ::-1]


def sources(n_cells, n_sources, gain_db, seed=0):
    """16 x 16 snapshots of sources at least two Rayleigh cells apart, gain_db over noise on all elements."""
    rng = np.random.default_rng(seed)
    snapshots = noise(n_cells, 16, 16, seed=seed)
    slots = np.linspace(-0.75, 0.75, n_sources)
    for cell in range(n_cells):
        for u, w in zip(slots, rng.permutation(slots), strict=True):
            gain = np.sqrt(10 ** (gain_db / 10) / 256) * np.exp(2j * np.pi * rng.random())
            snapshots[cell] += gain * np.outer(steering(16, u), steering(16, w))
    return snapshots


def descending(least, most, min_size, max_size):
    """Lists of eigenvalues."""
    values = st.lists(st.floats(least, most), min_size=min_size, max_size=max_size)
    return values.map(lambda value: sorted(value, reverse=True))


@given(descending(0, 10, 2, 8), st.floats(0, 10))
def test_the_noise_order_counts_what_noise_does_not_reach_but_leaves_both_a_dimension(eigenvalues, edge):
    above = sum(value > edge for value in eigenvalues)
    expected = min(max(above, 1), len(eigenvalues) - 1)
    assert noise_order(np.array([eigenvalues]), edge).tolist() == [expected]


def test_the_noise_edge_is_where_the_eigenvalues_of_a_large_noise_covariance_end():
    for n_sensors, n_snapshots in ((100, 400), (100, 100)):
        x = noise(n_sensors, n_snapshots)
        largest = np.linalg.eigvalsh(x @ x.conj().T / n_snapshots)[-1]
        assert largest == pytest.approx(noise_edge(n_sensors, n_snapshots), rel=0.08)
    assert noise_edge(9, 9) == pytest.approx(4)


@given(descending(0, 1e3, 3, 10), st.floats(1e-6, 0.5), st.integers(-20, 20))
def test_the_eigenvalue_cfar_holds_each_eigenvalue_against_the_mean_of_its_neighbours_in_any_unit(
    eigenvalues, pfa, exponent
):
    n = len(eigenvalues)
    side = (n - 1) // 2
    n_above = 0
    for i, value in enumerate(eigenvalues):
        first = min(max(i - side, 0), n - 1 - 2 * side)
        training = [eigenvalues[j] for j in range(first, first + 2 * side + 1) if j != i]
        n_above += value > ca_factor(pfa, 2 * side) * sum(training) / (2 * side)
    for unit in (1.0, 2.0**exponent):
        assert eigenvalue_cfar_order(unit * np.array([eigenvalues]), pfa)[0] == min(max(n_above, 1), n - 1)


def test_in_the_eigenvalue_cfar_equal_sources_mask_each_other_as_documented():
    eigenvalues = np.array([[100.0] * 4 + [1.0] * 4])
    assert eigenvalue_cfar_order(eigenvalues, 1e-2).tolist() == [1]
    assert noise_order(eigenvalues, noise_edge(8, 16)).tolist() == [4]


def test_the_eigenvalue_cfar_stands_the_rounding_of_a_singular_covariance():
    assert eigenvalue_cfar_order(np.array([[5.0, 1e-17, -1e-17, -2e-17]]), 1e-2).tolist() == [1]


@given(st.integers(0, 999), st.tuples(st.integers(2, 9), st.integers(2, 9)), st.floats(0.3, 0.9))
def test_no_snapshot_of_unit_energy_has_a_larger_eigenvalue_than_the_edge_charges_for_it(
    seed, shape, fraction
):
    subarray = tuple(max(2, round(fraction * n)) for n in shape)
    # The edge grows by the weight of one unit of energy for a rate e times smaller.
    weight = smoothed_noise_edge(shape, subarray, 1e-4) - smoothed_noise_edge(shape, subarray, np.e * 1e-4)
    cells = noise(20, *shape, seed=seed)
    cells /= np.linalg.norm(cells, axis=(1, 2), keepdims=True)
    cells[0] = np.outer(*(np.bartlett(n + 2)[1:-1] for n in shape))
    cells[0] /= np.linalg.norm(cells[0])
    largest = eigenvalues_of(cells, subarray)[:, 0]
    assert largest.max() <= weight * (1 + 1e-9)
    assert largest[0] > 0.6 * weight


@pytest.mark.parametrize(("shape", "subarray"), [((8, 8), (4, 4)), ((8, 8), (5, 5)), ((16, 4), (8, 2))])
def test_noise_exceeds_its_edge_about_as_often_as_asked(shape, subarray):
    pfa = 0.05
    largest = eigenvalues_of(noise(2400, *shape), subarray)[:, 0]
    rate = np.mean(largest > smoothed_noise_edge(shape, subarray, pfa))
    assert pfa / 5 < rate < 1.2 * pfa


@pytest.mark.parametrize("order", [1, 2, 4])
@pytest.mark.parametrize("method", ["noise", "mdl", "aic"])
def test_strong_separate_sources_of_one_snapshot_are_counted(method, order):
    values = eigenvalues_of(sources(20, order, gain_db=45), (8, 8))
    if method == "noise":
        found = noise_order(values, smoothed_noise_edge((16, 16), (8, 8), 1e-5))
    else:
        found = information_order(values, 4, method)
    assert found.tolist() == [order] * 20


@pytest.mark.parametrize("criterion", ["mdl", "aic"])
def test_in_noise_the_criteria_fall_back_to_one_source_and_with_overlapping_looks_they_do_not(criterion):
    values = eigenvalues_of(noise(60, 16, 16), (8, 8))
    assert information_order(values, 4, criterion).tolist() == [1] * 60
    if criterion == "aic":
        assert np.mean(information_order(values, 81, criterion) > 1) > 0.5


@given(descending(1e-3, 1e3, 2, 9), st.floats(1, 100), st.sampled_from(["mdl", "aic"]), st.integers(-20, 20))
def test_the_criteria_are_those_of_wax_and_kailath_for_real_covariances_and_know_no_scale(
    eigenvalues, n_independent, criterion, exponent
):
    values, n_real, size = np.array(eigenvalues), 2 * n_independent, len(eigenvalues)
    scores = []
    for k in range(size):
        rest = values[k:]
        likelihood = -n_real / 2 * (np.sum(np.log(rest)) - len(rest) * np.log(np.mean(rest)))
        n_free = k * (2 * size - k + 1) / 2
        scores.append(likelihood + (n_free if criterion == "aic" else n_free * np.log(n_real) / 2))
    found = information_order(values[None], n_independent, criterion)[0]
    # Rounding decides between equal scores.
    least = min(scores)
    equal = {min(max(k, 1), size - 1) for k in range(size) if scores[k] - least < 1e-9 * (1 + abs(least))}
    assert found in equal
    assert information_order(2.0**exponent * values[None], n_independent, criterion)[0] in equal


@pytest.mark.parametrize("criterion", ["mdl", "aic"])
def test_the_criteria_stand_the_rounding_of_a_singular_covariance(criterion):
    assert information_order(np.array([[5.0, 1e-17, -1e-17]]), 4, criterion)[0] in (1, 2)
    assert information_order(np.zeros((1, 3)), 4, criterion)[0] in (1, 2)
