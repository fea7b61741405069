"""Detection on beams: false-alarm rates of all detectors, the law of the strongest beam, what is found."""

from functools import partial
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from isacbench_algorithms.detectors import CaCfar, GocaCfar, OscaCfar, OsCfar, SocaCfar, TmCfar
from scipy.stats import ncx2

from isacbench.dsp.beam_integration import BeamIntegration, Beams, _beam_level, independent_beams
from isacbench.dsp.cell_detection import detect_cells, power_map
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.model.gate import Gate
from isacbench.model.kernels import steering
from tests.dsp.plane_wave_data import noise

DETECTORS = CaCfar, OsCfar, OscaCfar, GocaCfar, SocaCfar, TmCfar
SQUARE = Gate(np.arange(32), np.arange(32), slice(0, 32), slice(0, 32))
SHAPE, LIMITS = (4, 3), ((-0.6, 0.7), (-0.2, 0.5))
PARTS = (
    Beams(SHAPE, LIMITS),
    Beams((8, 1), ((-0.3, 0.3), (0.0, 0.0))),
    Beams((2, 2), ((-1.0, 1.0), (-1.0, 1.0))),
)


def on_beams(cells, detector, beams, gate=SQUARE):
    """Detector on the beams of untapered cells in noise of unit power."""
    return BeamIntegration(detector, GatedMap(cells, gate).tapered(), beams, 1.0, 0.0)


@pytest.mark.parametrize("beams", PARTS, ids=["part of a plane", "line", "all directions"])
@pytest.mark.parametrize("detector", DETECTORS, ids=lambda one: one.name)
def test_the_false_alarm_rate_is_the_detectors_inside_at_edges_and_in_corners(detector, beams):
    pfa, n_maps, counts = 1e-2, 24, np.zeros((32, 32))
    for seed in range(n_maps):
        cells = noise(32, 32, *beams.shape, seed=seed)
        counts += on_beams(cells, detector(pfa=pfa), beams).detect(*power_map(cells, "noncoherent")).mask
    near = np.minimum(np.arange(32), np.arange(32)[::-1]) < 4
    n_edges = np.add.outer(1 * near, 1 * near)
    for place, alike in enumerate(("inside", "edge", "corner")):
        cells = n_edges == place
        expected = n_maps * cells.sum() * pfa
        assert abs(counts[cells].sum() - expected) < 4 * np.sqrt(expected) + 0.03 * expected, alike


@pytest.mark.parametrize("windows", [("rect", "rect"), ("hann", "hann")])
@pytest.mark.parametrize("detector", [CaCfar, OsCfar, partial(OscaCfar, order_axis=1)])
def test_cells_of_a_map_of_noise_are_detected_at_the_detectors_rate(detector, windows):
    pfa, n_maps, n_found = 1e-2, 16, 0
    gate = Gate(np.arange(40), np.arange(-16, 17), slice(4, 36), slice(7, 26))
    for seed in range(n_maps):
        tapered = GatedMap(noise(40, 33, 8, 8, seed=seed), gate).tapered(*windows)
        found = detect_cells(tapered, detector(pfa=pfa), "beams", 200.0, cosine_limits=LIMITS)
        n_found += found.bins[0].size
    expected = n_maps * np.count_nonzero(gate.reachable) * pfa
    assert abs(n_found - expected) < 4 * np.sqrt(expected) + 0.03 * expected


@pytest.mark.parametrize("error", [1 / 3, 0.8, 1.2, 3.0])
def test_a_wrong_level_of_white_noise_raises_no_false_alarms(error):
    pfa, n_maps, n_found = 1e-2, 12, 0
    for seed in range(n_maps):
        cells = noise(32, 32, 8, 8, seed=seed)
        tapered = GatedMap(cells, SQUARE).tapered()
        detector = BeamIntegration(CaCfar(pfa=pfa), tapered, Beams((8, 8), LIMITS), error, 0.0)
        n_found += np.count_nonzero(detector.detect(*power_map(cells, "noncoherent")).mask)
    expected = n_maps * 1024 * pfa
    assert n_found < 1.03 * expected + 4 * np.sqrt(expected)
    assert (n_found > expected - 4 * np.sqrt(expected)) == (error > 1)


@given(
    n=st.integers(2, 24),
    step=st.floats(0.2, 0.95),
    rate=st.sampled_from([1e-1, 1e-2, 1e-4, 1e-6]),
)
def test_two_beams_count_as_their_joint_exponential_law_says(n, step, rate):
    # Two beams of a line half a Rayleigh cell apart, or nearer at the ends of the region.
    beams = Beams((n, 1), ((0.0, step / n), (0.0, 0.0)))
    u, _ = beams.cosines
    assert u.size == 2
    shared = np.abs(np.vdot(steering(n, u[0]), steering(n, u[1])) / n) ** 2
    count = independent_beams(beams, rate)
    level = _beam_level(rate, count)
    # P(X > t, Y > t) of two exponentials with the squared correlation r, by Marcum's Q function.
    near, far = 2 * level * shared / (1 - shared), 2 * level / (1 - shared)
    both = np.exp(-level) * (1 + ncx2.sf(far, 2, near) - ncx2.sf(near, 2, far))
    union = 2 * np.exp(-level) - both
    assert union == pytest.approx(rate, rel=0.05)
    assert 1 <= count <= 2


@pytest.mark.parametrize("rate", [1e-2, 1e-3])
@pytest.mark.parametrize("beams", PARTS, ids=["part of a plane", "line", "all directions"])
def test_noise_raises_the_strongest_beam_above_the_level_of_a_rate_as_often(beams, rate):
    n_draws = 60_000
    outputs = beams.outputs(noise(n_draws, *beams.shape, seed=1))
    count = independent_beams(beams, rate)
    assert 1 <= count <= outputs.shape[-1]
    n_above = np.count_nonzero(np.max(np.abs(outputs) ** 2, axis=1) > _beam_level(rate, count))
    assert abs(n_above - n_draws * rate) < 4 * np.sqrt(n_draws * rate) + 0.03 * n_draws * rate


def test_one_beam_is_an_exponential_and_no_calibration_is_needed():
    beams = Beams((4, 4), ((0.1, 0.1), (0.2, 0.2)))
    assert independent_beams(beams, 1e-3) == pytest.approx(1)
    assert _beam_level(1e-3, 1) == pytest.approx(-np.log(1e-3))


@pytest.mark.parametrize("beams", PARTS, ids=["part of a plane", "line", "all directions"])
def test_beams_are_sums_over_the_elements_and_cover_the_region(beams):
    cells = noise(3, *beams.shape)
    outputs = beams.outputs(cells)
    for k in range(outputs.shape[-1]):
        u, w = beams.directions(np.array([k]))
        for cell, seen in zip(cells, outputs[:, k], strict=True):
            total = sum(
                cell[p, q] * np.exp(1j * np.pi * (p * u[0] + q * w[0]))
                for p, q in product(*map(range, beams.shape))
            )
            assert seen == pytest.approx(total / np.sqrt(cell.size))
    for n, cosine, (lower, upper) in zip(beams.shape, beams.cosines, beams.limits, strict=True):
        places = np.linspace(lower, upper, 50)
        # Halfway between two beams a line keeps 81 % of the power.
        kept = np.abs(steering(n, cosine).conj() @ steering(n, places).T / n) ** 2
        assert kept.max(axis=0).min() > 0.8


def test_a_list_of_cells_is_tested_as_the_whole_map_is():
    cells = noise(32, 32, *SHAPE)
    cells[5:8, 20:26] *= 3
    detector = on_beams(cells, OscaCfar(pfa=0.05), PARTS[0])
    power, looks = power_map(cells, "noncoherent")
    whole, random = detector.detect(power, looks), np.random.default_rng(2)
    # In any order.
    listed = tuple(random.permutation(np.argwhere(random.random((32, 32)) < 0.3)).T)
    some = detector.detect(power, looks, cells=listed)
    assert whole.mask.sum() > 20
    np.testing.assert_array_equal(some.mask, whole.mask[listed])
    np.testing.assert_array_equal(some.alone, whole.alone[listed])
    np.testing.assert_array_equal(some.beam[some.mask], whole.beam[listed][some.mask])
    np.testing.assert_allclose(some.threshold, whole.threshold[listed], rtol=1e-12)


@pytest.mark.parametrize("windows", [("rect", "rect"), ("hann", "soft")])
def test_beams_of_a_tapered_map_are_those_of_its_tapered_cells(windows):
    cells = noise(32, 32, *SHAPE)
    tapered = GatedMap(cells, SQUARE).tapered(*windows)
    power, looks = power_map(tapered.cells, "noncoherent")
    found = BeamIntegration(CaCfar(pfa=1e-9), tapered, PARTS[0], 1.0, 0.0).detect(power, looks)
    outputs = np.abs(PARTS[0].outputs(tapered.cells)) ** 2
    np.testing.assert_allclose(found.power, outputs.max(axis=-1), rtol=1e-12)
    np.testing.assert_array_equal(found.beam, outputs.argmax(axis=-1))


def echo(power, u, w, shape):
    """Plane wave of a power per element."""
    return np.sqrt(power) * steering(shape[0], u)[:, None] * steering(shape[1], w)


def test_a_weak_echo_is_found_in_its_beam_alone_as_often_as_its_power_says():
    shape, limits, pfa = (8, 8), ((-0.4, 0.4), (0.0, 0.5)), 1e-4
    beams = Beams(shape, limits)
    u, w = beams.directions(np.array([20]))
    level = _beam_level(pfa, independent_beams(beams, pfa))
    n_found, n_mean, n = 0, 0, 300
    power = 20 / 64  # 13 dB behind the array
    for seed in range(n // 4):
        cells = noise(32, 32, *shape, seed=seed)
        places = [(8, 8), (8, 24), (24, 8), (24, 24)]
        for place in places:
            cells[place] += echo(power, u[0], w[0], shape)
        found = on_beams(cells, CaCfar(pfa=pfa), beams).detect(*power_map(cells, "noncoherent"))
        for place in places:
            n_found += found.mask[place]
            n_mean += not found.alone[place]
            if found.mask[place]:
                seen = beams.directions(found.beam[place])
                assert np.hypot(seen[0] - u[0], seen[1] - w[0]) < 0.3
    # The output of its beam has the Rice law; neighbouring beams add a few per cent.
    least = ncx2.sf(2 * level, 2, 2 * 20)
    assert least - 0.08 < n_found / n < least + 0.12
    assert n_mean / n < 0.3


def test_a_cell_below_the_leakage_of_the_strongest_is_not_detected():
    gate = Gate(np.arange(32), np.arange(32), slice(4, 28), slice(4, 28))
    cells = noise(32, 32, *SHAPE)
    cells[10:15, 10:14] += echo(1e5, 0.1, 0.1, SHAPE)
    cells[22, 22] += echo(20.0, 0.1, 0.1, SHAPE)
    tapered = GatedMap(cells, gate).tapered()
    kept = [
        (22, 22) in zip(*detect_cells(tapered, CaCfar(), "beams", db, cosine_limits=LIMITS).bins, strict=True)
        for db in (30.0, 60.0)
    ]
    assert kept == [False, True]


def test_a_beam_alone_must_exceed_the_leakage_of_two_echoes_in_phase():
    beams, cells = PARTS[0], noise(32, 32, *SHAPE)
    u, w = beams.directions(np.array([5]))
    cells[16, 16] = echo(1.2, u[0], w[0], SHAPE)
    power, looks = power_map(cells, "noncoherent")
    tapered, detector = GatedMap(cells, SQUARE).tapered(), CaCfar(pfa=1e-4)
    found = {
        leakage: BeamIntegration(detector, tapered, beams, 1.0, leakage).detect(power, looks)
        for leakage in (0.2, 0.4)
    }
    assert found[0.2].alone[16, 16]
    assert [one.mask[16, 16] for one in found.values()] == [True, False]
