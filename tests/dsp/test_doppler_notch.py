"""Zero-Doppler notch: static echoes go, others stay, and noise keeps its power."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from isacbench_algorithms.omp4d import Omp4d

from isacbench.dsp.bursts import symbol_bursts
from isacbench.dsp.doppler_notch import without_slow_points, without_static_echoes
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.dsp.windows import taper
from isacbench.errors import InputError
from isacbench.model.cloud import PointCloud
from isacbench.model.gate import Gate
from isacbench.model.numerology import Prs, System
from tests.algorithms.scenes import EACH_CELLWISE, simulator

SYSTEM = System(n_subcarriers=256, n_symbols=224, prs=Prs(period=1))
BINS = np.arange(-20, 21)
SENSED = pytest.mark.parametrize("sensing", ["all", "prs"])


def gated(cells, sensing="all", bins=BINS):
    """Map of cells (n_range, n_doppler, P, Q), whose inner half is within reach."""
    n_range, n_doppler = cells.shape[:2]
    gate = Gate(
        np.arange(n_range),
        bins,
        slice(n_range // 4, n_range - n_range // 4),
        slice(n_doppler // 4, n_doppler - n_doppler // 4),
    )
    return GatedMap(cells, gate, bursts=symbol_bursts(SYSTEM, sensing))


def echo(doppler_bin, sensing="all", bins=BINS):
    """Row of Doppler bins (n_doppler,) of a unit echo."""
    return symbol_bursts(SYSTEM, sensing).response(bins, [doppler_bin])[:, 0] / np.sqrt(SYSTEM.n_symbols)


def noise(n_range=40, seed=0):
    real, imag = np.random.default_rng(seed).standard_normal((2, n_range, BINS.size, 2, 3)) / np.sqrt(2)
    return real + 1j * imag


@SENSED
@given(st.floats(-60, 120), st.integers(0, 3))
def test_a_static_echo_of_any_strength_leaves_the_map_as_if_it_were_not_there(sensing, power_db, seed):
    direction = 10 ** (power_db / 20) * np.exp(2j * np.pi * np.random.default_rng(seed).random((2, 3)))
    cells = noise(seed=seed)
    with_echo = cells.copy()
    # Away from the range bins in which bursts have their noise measured.
    with_echo[12] += np.multiply.outer(echo(0, sensing), direction)
    alone, seen = (
        without_static_echoes(gated(one, sensing), SYSTEM, "hann").cells for one in (cells, with_echo)
    )
    np.testing.assert_allclose(seen, alone, atol=1e-9 * max(1, 10 ** (power_db / 20)))


def test_an_echo_three_and_a_half_bins_away_changes_by_less_than_40_db():
    for place in np.r_[3.5:9:0.25]:
        cells = np.zeros((40, BINS.size, 2, 3), complex)
        cells[20] = echo(place)[:, None, None]
        found = gated(without_static_echoes(gated(cells), SYSTEM, "hann").cells)
        change, own = (taper(one, "hann", 0) for one in (found.cells[20] - cells[20], cells[20]))
        assert np.linalg.norm(change) < 1e-2 * np.linalg.norm(own), place


def test_the_static_echo_is_fitted_to_tapered_bins_of_each_range_and_element():
    cells = noise()
    cells[20] += 100 * echo(0)[:, None, None] + 30 * echo(1.3)[:, None, None]
    found = without_static_echoes(gated(cells), SYSTEM, "hann").cells
    row = taper(echo(0), "hann", 0)
    for n in (20, 25):
        for p, q in np.ndindex(2, 3):
            fitted = np.linalg.lstsq(row[:, None], taper(cells[n, :, p, q], "hann", 0), rcond=None)[0]
            left = cells[n, :, p, q] - fitted * echo(0)
            change = found[n, :, p, q] - left
            # Noise of about the map's own power, 1, along the static echo.
            np.testing.assert_allclose(change, np.vdot(echo(0), change) * echo(0), atol=1e-9)
            assert abs(np.vdot(echo(0), change)) < 5


@SENSED
def test_noise_keeps_its_power_where_detectors_look(sensing):
    cells = noise(n_range=2000)
    found = without_static_echoes(gated(cells, sensing), SYSTEM, "hann").cells
    power = (np.abs(taper(found, "hann", 1)) ** 2).mean(axis=(0, 2, 3))
    middle = len(power) // 2
    np.testing.assert_allclose(np.delete(power, [middle - 1, middle, middle + 1]), 1, rtol=0.06)
    # The bins that hear a static echo: as much together, if not each.
    assert power[middle - 1 : middle + 2].mean() == pytest.approx(1, rel=0.06)
    assert power[middle - 1 : middle + 2].min() > 0.7


def test_it_is_the_same_every_time_and_leaves_its_input_alone():
    cells = noise()
    before = cells.copy()
    first, second = (without_static_echoes(gated(cells), SYSTEM, "hann").cells for _ in range(2))
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(cells, before)


def test_a_map_without_zero_doppler_stays():
    away = gated(noise(), bins=BINS + 30)
    assert without_static_echoes(away, SYSTEM, "hann") is away


def test_points_no_faster_than_the_notch_or_a_velocity_bin_are_left_out():
    bins = np.array([-3.0, -2.0, -0.5, 0.0, 1.0, 1.1, 2.1])
    cloud = PointCloud(np.zeros((bins.size, 3)), bins * SYSTEM.velocity_bin_mps, np.ones(bins.size))
    for notch, kept in ((2.0, [-3.0, 2.1]), (0.0, [-3.0, -2.0, 1.1, 2.1])):
        left = without_slow_points(cloud, SYSTEM, notch * SYSTEM.velocity_bin_mps)
        np.testing.assert_allclose(left.velocity / SYSTEM.velocity_bin_mps, kept)


@EACH_CELLWISE
def test_a_mover_80_db_below_a_static_echo_is_seen_with_a_notch(estimator):
    places = [[4.0, 6.0, 2.0], [21.0, 27.0, 4.0]]
    seen = simulator(places, [0.0, 13.3], [1e4, 1.0]).observe(90.0)
    shown = {notch: estimator(notch_mps=notch).estimate(seen) for notch in (None, 1.0)}
    near = {notch: np.abs(cloud.velocity - 13.3) < 0.5 for notch, cloud in shown.items()}
    assert near[1.0].sum() == 1
    assert not near[None].any()
    np.testing.assert_allclose(shown[1.0].xyz[near[1.0]], places[1:], atol=0.5)
    assert (np.abs(shown[1.0].velocity) > 1.0).all()


@pytest.mark.parametrize("notch_mps", [-1.0, -np.inf, np.nan])
def test_a_notch_that_is_no_speed_is_refused(notch_mps):
    with pytest.raises(InputError, match=r"notch_mps = .*: allowed is a speed from 0 on, or none"):
        Omp4d(notch_mps=notch_mps)
