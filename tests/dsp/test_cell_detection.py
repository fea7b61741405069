"""Detected cells: one element or all, what is reachable, and the two floors."""

from dataclasses import dataclass
from itertools import product
from math import comb
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from isacbench_algorithms.detectors import CaCfar
from scipy.stats import chi2

from isacbench.dsp.cell_detection import (
    CLEAR_BINS,
    PEAK_CELLS,
    BinaryIntegration,
    detect_cells,
    power_map,
    reference_noise,
    white_noise,
)
from isacbench.dsp.detection import detect_listed
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.errors import InputError
from isacbench.model.gate import Gate
from isacbench.model.kernels import dirichlet
from isacbench.plugins.contracts import Detection
from tests.dsp.plane_wave_data import noise

GATE = Gate(np.arange(40, 70), np.arange(-12, 13), slice(6, 24), slice(8, 17))
NO_CLEAR_BINS = Gate(np.arange(40, 70), np.arange(-12, 13), slice(0, 30), slice(2, 23))
LARGE = Gate(np.arange(300), np.arange(200), slice(0), slice(0))
LOOKS = 12


@dataclass(frozen=True)
class Everything:
    """Detects every cell, or those of a mask; says that the noise is 3."""

    name: ClassVar[str] = "everything"
    pfa: float = 0.5
    mask: np.ndarray | None = None

    def detect(self, power, looks=1):
        assert looks == LOOKS
        mask = np.ones(power.shape, dtype=bool) if self.mask is None else self.mask
        return Detection(mask, np.zeros_like(power), np.full_like(power, 3.0))


@dataclass(frozen=True)
class Picky(Everything):
    """Detects what it is asked for, and refuses to test a whole map."""

    def detect(self, power, looks=1, cells=None):
        assert cells is not None
        return Detection(power[cells] > 1, np.zeros(cells[0].size), np.full(cells[0].size, 3.0))


def noise_cells(gate, seed=0, elements=(4, 3)):
    """White complex noise of unit power."""
    return noise(*gate.shape, *elements, seed=seed)


@pytest.mark.parametrize("elements", [(4, 3), (6,)], ids=["plane", "cross"])
@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("integration", ["element", "noncoherent"])
def test_power_is_the_mean_over_the_elements_and_has_a_look_each(elements, order, integration):
    cells = np.asarray(noise_cells(GATE, elements=elements), order=order)
    cells.setflags(write=False)
    power, looks = power_map(cells, integration)
    n = 1 if integration == "element" else np.prod(elements)
    assert (looks, power.dtype) == (n, np.float64)
    of_each = cells.reshape(*GATE.shape, -1)
    for row, column in np.ndindex(GATE.shape):
        expected = sum(abs(of_each[row, column, k]) ** 2 for k in range(n)) / n
        assert power[row, column] == pytest.approx(expected)
    single, _ = power_map(cells.astype(np.complex64), integration)
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, power, rtol=1e-5)


@pytest.mark.parametrize("integration", ["element", "noncoherent"])
def test_the_looks_are_those_of_the_variance_in_noise(integration):
    power, looks = power_map(noise_cells(LARGE), integration)
    assert power.mean() ** 2 / power.var() == pytest.approx(looks, rel=0.05)


@given(seed=st.integers(0, 999), dynamic_range_db=st.floats(0.1, 30), contrast_db=st.floats(0, 40))
def test_cells_are_kept_where_detected_reachable_and_above_the_floor(seed, dynamic_range_db, contrast_db):
    rng = np.random.default_rng(seed)
    cells = noise_cells(GATE, seed) * 10 ** (rng.random((*GATE.shape, 1, 1)) * contrast_db / 20)
    mask = rng.random(GATE.shape) < 0.7
    found = detect_cells(
        GatedMap(cells, GATE).tapered(), Everything(mask=mask), "noncoherent", dynamic_range_db
    )
    power = np.mean(np.abs(cells) ** 2, axis=(2, 3))
    reachable = [*product(range(6, 24), range(8, 17))]
    strongest = sorted(power[cell] for cell in reachable)[-PEAK_CELLS:]
    clear = [c for c in range(25) if c < 8 - CLEAR_BINS or c >= 17 + CLEAR_BINS]
    below_strongest = sum(strongest) / PEAK_CELLS * 10 ** (-dynamic_range_db / 10)
    floor = max(np.median(power[:, clear].mean(axis=0)), below_strongest)
    assert found.floor == pytest.approx(floor)
    expected = [cell for cell in reachable if mask[cell] and power[cell] > floor]
    assert list(zip(found.bins[0] - 40, found.bins[1] + 12, strict=True)) == expected


def test_two_echoes_in_phase_in_one_cell_do_not_hide_what_is_within_the_range_of_all_the_others():
    amplitude = np.full(GATE.shape, 1e-3)
    amplitude[6, 8:17] = amplitude[7, 8:17] = amplitude[8, 8] = 10.0
    amplitude[8, 9] = 20.0  # the sum of two
    amplitude[12, 12] = np.sqrt(2.0)
    cells = np.broadcast_to(amplitude[:, :, None, None], (*GATE.shape, 4, 3)).astype(complex)
    found = detect_cells(GatedMap(cells, GATE).tapered(), Everything(), "noncoherent", 20.0)
    assert len(found.bins[0]) == 21
    # 20 dB below the mean of 19 cells of power 100 and one of 400.
    assert found.floor == pytest.approx(1.15)


def test_the_strongest_cell_that_is_kept_is_named_by_its_bins():
    cells = noise_cells(GATE)
    cells[10, 12] *= 30
    cells[3, 12] *= 90  # beyond reach
    found = detect_cells(GatedMap(cells, GATE).tapered(), Everything(), "noncoherent", 30.0)
    assert [bins.tolist() for bins in found.strongest().bins] == [[50], [0]]


def test_where_nothing_is_kept_there_is_no_strongest_cell():
    nothing = Everything(mask=np.zeros(GATE.shape, dtype=bool))
    found = detect_cells(GatedMap(noise_cells(GATE), GATE).tapered(), nothing, "noncoherent", 30.0)
    assert found.bins[0].size == found.bins[1].size == 0
    assert found.strongest().bins[0].size == 0


def test_without_clear_doppler_bins_the_floor_falls_back_on_the_noise_of_the_detector():
    gated = GatedMap(noise_cells(NO_CLEAR_BINS), NO_CLEAR_BINS)
    found = detect_cells(gated.tapered(), Everything(), "noncoherent", 60.0)
    assert reference_noise(found.power, NO_CLEAR_BINS) is None
    assert found.floor == 3.0


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("noise_power", [1e-9, 1.0, 1e9])
def test_reference_noise_lies_within_the_chi_square_band_of_its_cells(seed, noise_power):
    power, looks = power_map(np.sqrt(noise_power) * noise_cells(GATE, seed), "noncoherent")
    n_degrees = 2 * looks * GATE.shape[0] * 10
    low, high = chi2.ppf([1e-6, 1 - 1e-6], n_degrees) / n_degrees
    assert low < reference_noise(power, GATE) / noise_power < high


@pytest.mark.parametrize("doppler", [-4.4, -1.7, 0.0, 2.5, 4.4])
def test_strong_movers_at_any_speed_of_the_region_do_not_reach_the_reference_noise(doppler):
    quiet_cells = noise_cells(GATE)
    mover = 100 * dirichlet(GATE.doppler_bins, [doppler], 64)[:, 0].conj() / 8
    cells = quiet_cells.copy()
    cells[15] += mover[:, None, None]
    quiet, loud = (GatedMap(part, GATE).tapered("hann", "hann") for part in (quiet_cells, cells))
    powers = [power_map(part.cells, "noncoherent")[0] for part in (quiet, loud)]
    before, after = (reference_noise(power, quiet.gate) for power in powers)
    assert after == pytest.approx(before, rel=0.03)
    assert powers[1].mean() > 10 * powers[0].mean()


@pytest.mark.parametrize("noise_power", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("gate", [GATE, NO_CLEAR_BINS], ids=["clear", "no clear bins"])
def test_white_noise_is_that_of_a_cell_and_element_of_the_untapered_map(gate, noise_power):
    found = white_noise(GatedMap(np.sqrt(noise_power) * noise_cells(gate), gate))
    # A median of gamma variates of 12 looks lies 3 % below their mean.
    assert found == pytest.approx(noise_power, rel=0.08)


@pytest.mark.parametrize("doppler", [-4.4, -1.7, 0.5, 2.5])
@pytest.mark.parametrize("range_bin", [46.0, 55.4])
def test_an_echo_70_db_above_the_noise_does_not_raise_white_noise(range_bin, doppler):
    still = noise_cells(GATE)
    along_range = dirichlet(GATE.range_bins, [range_bin], 256)[:, 0] / 16
    along_doppler = dirichlet(GATE.doppler_bins, [doppler], 1024)[:, 0].conj() / 32
    echo = 10**3.5 * np.outer(along_range, along_doppler)[:, :, None, None]
    quiet, loud = (white_noise(GatedMap(cells, GATE)) for cells in (still, still + echo))
    bare = reference_noise(power_map(still + echo, "noncoherent")[0], GATE)
    assert bare > 10 * quiet
    assert loud < 1.15 * quiet


def test_without_clear_doppler_bins_white_noise_is_the_median_of_the_map():
    gated = GatedMap(noise_cells(NO_CLEAR_BINS), NO_CLEAR_BINS)
    power = np.mean(np.abs(gated.tapered("rect", "hann").cells) ** 2, axis=(2, 3))
    assert white_noise(gated) == pytest.approx(np.median(power))


def test_a_detector_that_takes_cells_is_asked_for_those_alone_and_of_another_they_are_picked():
    power = noise_cells(GATE)[..., 0, 0].real ** 2
    cells = np.nonzero(power > 0.5)
    for detector in (Picky(), Everything(mask=power > 1)):
        found = detect_listed(detector, power, LOOKS, cells)
        assert np.array_equal(found.mask, power[cells] > 1)
        assert found.threshold.shape == found.noise.shape == cells[0].shape


def test_where_clear_bins_give_the_floor_the_map_is_not_tested_beyond_what_may_be_kept():
    cells = noise_cells(GATE, elements=(4, 3))
    picked = detect_cells(GatedMap(cells, GATE).tapered(), Picky(), "noncoherent", 30.0)
    everything = np.mean(np.abs(cells) ** 2, axis=(2, 3)) > 1
    full = detect_cells(GatedMap(cells, GATE).tapered(), Everything(mask=everything), "noncoherent", 30.0)
    assert np.array_equal(picked.bins, full.bins)
    assert picked.bins[0].size
    assert full.detection.mask.shape == GATE.shape


@pytest.mark.parametrize("m", [1, 2, 12])
def test_binary_integration_detects_where_m_elements_do(m):
    cells = noise_cells(GATE)
    cells[10, 12] += 9
    cells[15, 10, 1, :2] += 9
    found = detect_cells(GatedMap(cells, GATE).tapered(), CaCfar(pfa=0.03), "binary", 30.0, m)
    each = np.moveaxis(abs(cells.reshape(*GATE.shape, -1)) ** 2, -1, 0)
    expected = sum(CaCfar(pfa=0.03).detect(power).mask.astype(int) for power in each)
    np.testing.assert_array_equal(found.detection.mask, expected >= m)
    kept = [*zip(found.bins[0] - GATE.range_bins[0], found.bins[1] - GATE.doppler_bins[0], strict=True)]
    passes = (expected >= m) & (np.max(abs(cells), axis=(2, 3)) ** 2 > found.floor)
    assert kept == [cell for cell in product(range(6, 24), range(8, 17)) if passes[cell]]
    assert (10, 12) in kept
    assert ((15, 10) in kept) == (m <= 2)


@pytest.mark.parametrize("m", [1, 2, 3])
def test_binary_integration_has_the_binomial_probability_of_false_alarm(m):
    powers = np.abs(noise_cells(LARGE).reshape(300, 200, 12)) ** 2
    united = BinaryIntegration(CaCfar(pfa=0.05), powers, m)
    closed = sum(comb(12, k) * 0.05**k * 0.95 ** (12 - k) for k in range(m, 13))
    assert united.pfa == pytest.approx(closed)
    assert united.detect(powers[..., 0]).mask.mean() == pytest.approx(closed, rel=0.06)


@pytest.mark.parametrize("m", [0, 13])
def test_binary_integration_needs_as_many_elements_as_there_are(m):
    with pytest.raises(InputError, match=f"m_of_n = {m}: .*12 elements"):
        detect_cells(GatedMap(noise_cells(GATE), GATE).tapered(), CaCfar(), "binary", 30.0, m)
