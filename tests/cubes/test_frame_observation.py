"""Recorded frames: the image is that of the unabridged chain, and nothing is read that nobody asked for."""

import dataclasses

import numpy as np
import pytest
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.music2d import Music2d
from isacbench_algorithms.references import Oracle

from isacbench import observe_cube
from isacbench.cubes import frame
from isacbench.dsp import partial_dft
from isacbench.errors import InputWarning
from isacbench.link.sensing.division import Signal
from isacbench.link.sensing.link_observation import SignalSimulator
from isacbench.link.waveform.resource_grid import draw_grid
from isacbench.model.echo import resource_grid
from isacbench.model.numerology import prs_elements
from isacbench.model.observation import Observation, cross_elements
from tests.conftest import refusal
from tests.gated_cells import cells_in_gate, gate_of

ESTIMATORS = [Music2d(), Music2d(integration="element"), Fft4d()]
ids = ["music2d", "music2d-element", "fft4d"]


def unabridged(cube, scenario):
    """Observation by whole transforms of every element in double precision, and then cut out."""
    gate = gate_of(scenario)
    cells = cells_in_gate(cube.astype(np.complex128), gate)
    radio = scenario.system, scenario.array, scenario.frame, scenario.base_station_m, scenario.region
    return Observation(cells, gate, *radio)


def assert_cells_are_unabridged(cube, scenario):
    cells, expected = observe_cube(cube, scenario).cells, unabridged(cube, scenario).cells
    np.testing.assert_allclose(cells, expected, atol=1e-11 * np.abs(expected).max())
    return cells


def assert_same_cloud(cloud, expected):
    """Same points to 5e-6 of the coordinates' size: single precision moves echoes 33 dB below others."""
    assert len(expected) > 5
    assert len(cloud) == len(expected)
    for values, wanted in zip(cloud.to_array().T, expected.to_array().T, strict=True):
        np.testing.assert_allclose(values, wanted, rtol=0, atol=5e-6 * np.abs(wanted).max())


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=ids)
@pytest.mark.parametrize(("dtype", "order"), [(np.complex64, "C"), (np.complex128, "F")])
def test_the_image_of_a_cube_is_that_of_the_unabridged_chain(
    small_street, noisy_cube, estimator, dtype, order
):
    cube = np.asarray(noisy_cube.astype(dtype), order=order)
    expected = estimator.estimate(unabridged(noisy_cube.astype(dtype), small_street))
    assert_same_cloud(estimator.estimate(observe_cube(cube, small_street)), expected)


@pytest.mark.parametrize("method", ["partial", "fft"])
def test_both_ways_to_the_range_bins_give_the_same_cells(small_street, noisy_cube, monkeypatch, method):
    monkeypatch.setattr(partial_dft, "range_method", lambda *_: method)
    assert_cells_are_unabridged(noisy_cube, small_street)


def test_cells_do_not_depend_on_the_number_of_threads(small_street, noisy_cube):
    cube = noisy_cube.astype(np.complex64)
    one, three = (observe_cube(cube, small_street, workers=n).cells for n in (1, 3))
    assert np.array_equal(one, three)


def test_nothing_is_transformed_before_an_estimator_reads_it(small_street, noisy_cube, monkeypatch):
    monkeypatch.setattr(frame, "gate_cells", lambda *_: pytest.fail("transformed"))
    observation = observe_cube(noisy_cube, small_street)
    assert len(Oracle().estimate(observation, small_street.truth)) > 20


def test_what_no_estimator_reads_may_be_anything(small_street, noisy_cube):
    cube = np.full_like(noisy_cube, np.nan)
    p, q = cross_elements(small_street.array.shape).T
    cube[:, :, p, q] = noisy_cube[:, :, p, q]
    estimator = Music2d(integration="element")
    expected = estimator.estimate(observe_cube(noisy_cube, small_street))
    assert_same_cloud(estimator.estimate(observe_cube(cube, small_street)), expected)


def test_the_cross_is_part_of_the_plane(small_street, noisy_cube):
    apart, whole = (observe_cube(noisy_cube, small_street) for _ in range(2))
    p, q = cross_elements(small_street.array.shape).T
    scale = np.abs(whole.cells).max()
    np.testing.assert_allclose(apart.cross, whole.cells[:, :, p, q], atol=1e-13 * scale)
    assert np.array_equal(whole.cross, whole.cells[:, :, p, q])
    assert not apart.cross.flags.writeable
    assert not whole.cells.flags.writeable


def test_a_received_frame_is_divided_by_the_transmitted_grid(small_street, noisy_cube, order):
    rng = np.random.default_rng(3)
    transmitted = np.exp(2j * np.pi * rng.random(noisy_cube.shape[:2])) * rng.choice([0.5, 1, 2], (512, 56))
    received = np.asarray(noisy_cube * transmitted[:, :, None, None], order=order)
    cells = observe_cube(received, small_street, transmitted).cells
    expected = observe_cube(noisy_cube, small_street).cells
    np.testing.assert_allclose(cells, expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("division", ["reciprocal", "matched", "wiener"])
@pytest.mark.parametrize("sensing", ["all", "prs"])
def test_a_received_frame_is_divided_as_the_closed_form_has_it(small_street, sensing, division):
    system, shape = small_street.system, small_street.array.shape
    grid = draw_grid(system, "64qam").symbols
    echo = resource_grid(small_street, small_street.array.positions)
    received = (echo * grid[:, :, None]).reshape(*grid.shape, *shape)
    snr_db = 3.0 if division == "wiener" else None
    given = {"sensing": sensing, "division": division, "snr_db": snr_db}
    cells = observe_cube(received, small_street, grid, **given).cells
    signal = Signal("64qam", sensing, division)
    expected = SignalSimulator(small_street, signal).echo_cells(3.0)
    # Wiener division takes the mean power of this frame's symbols, the closed form that of the constellation.
    tolerance = 2e-3 if (sensing, division) == ("all", "wiener") else 1e-11
    np.testing.assert_allclose(cells, expected, atol=tolerance * np.abs(expected).max())
    twice = observe_cube(received, small_street, 2 * grid, **given)
    np.testing.assert_allclose(2 * twice.cells, cells, atol=1e-12 * np.abs(cells).max())


def test_of_the_prs_alone_nobody_knows_the_data(small_street, noisy_cube):
    is_prs = prs_elements(small_street.system)
    grid = np.where(is_prs, np.exp(1j * np.arange(is_prs.size).reshape(is_prs.shape)), np.nan)
    received = noisy_cube * np.where(is_prs, grid, 7)[:, :, None, None]
    unknown = observe_cube(received, small_street, grid, sensing="prs").cells
    divided = observe_cube(noisy_cube, small_street, sensing="prs").cells
    np.testing.assert_allclose(unknown, divided, atol=1e-12 * np.abs(divided).max())


def test_a_wrong_cube_or_grid_and_a_division_that_lacks_something_are_refused_at_once(
    small_street, noisy_cube
):
    for message, given in {
        "'matched' needs the transmitted grid": {"division": "matched"},
        "takes the SNR of the echo": {"division": "wiener", "transmitted": np.ones((512, 56))},
        "division = 'wiener', and no other, takes the SNR": {"snr_db": 10.0},
        "unknown sensing 'some'": {"sensing": "some"},
        "(512, 56)": {"transmitted": np.ones((512, 55))},
        "subcarrier 0, symbol 0": {"transmitted": np.zeros((512, 56))},
        "finite": {"transmitted": np.full((512, 56), np.nan)},
        "numbers": {"transmitted": np.full((512, 56), "x")},
    }.items():
        assert message in refusal(observe_cube, noisy_cube, small_street, **given)
    message = refusal(observe_cube, noisy_cube[:511], small_street)
    assert "has shape (511, 56, 8, 6); the scenario takes" in message


def test_a_number_that_is_not_finite_is_named_before_anything_is_estimated(small_street, noisy_cube):
    for value, order in ((np.nan, "F"), (np.inf, "C"), (complex(0, -np.inf), "F")):
        cube = np.array(noisy_cube, order=order)
        cube[300, 17, 3, 5] = value
        message = refusal(Music2d().estimate, observe_cube(cube, small_street))
        assert "subcarrier 300, symbol 17, element (3, 5); allowed are finite" in message


def test_numbers_whose_sums_overflow_single_precision_are_told(small_street, noisy_cube):
    cube = (noisy_cube * (1e38 / np.abs(noisy_cube).max())).astype(np.complex64)
    observation = observe_cube(cube, small_street)
    assert "overflow complex64" in refusal(lambda: observation.cells)


def test_a_region_that_spans_the_whole_map_is_imaged_too(small_street, noisy_cube):
    limit = small_street.system.unambiguous_speed_mps
    region = dataclasses.replace(small_street.region, speed_mps=(-limit, limit))
    everywhere = dataclasses.replace(small_street, region=region)
    assert assert_cells_are_unabridged(noisy_cube, everywhere).shape[1] == 56


def test_subcarriers_and_symbols_of_zeros_are_told_unless_the_grid_says_so(small_street, noisy_cube):
    for empty, message in (
        (np.s_[[0, 1, -1]], "3 subcarriers from 0 on hold zeros"),
        (np.s_[:, -2:], "2 symbols from "),
    ):
        frame = noisy_cube.copy()
        frame[empty] = 0
        with pytest.warns(InputWarning, match=f"array: {message}"):
            assert observe_cube(frame, small_street).cells.any()
    used = np.ones(noisy_cube.shape[:2])
    used[5] = 0
    assert observe_cube(noisy_cube * used[:, :, None, None], small_street, used).cells.any()
