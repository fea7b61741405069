"""Transmitted grids that are 0 at DC, in guard carriers or in others: the image is that of the whole grid."""

from dataclasses import replace

import numpy as np
import pytest

from isacbench.cubes.frame import observe_cube, summarise_frame
from isacbench.dsp.null_carriers import interpolate_nulls
from isacbench.dsp.partial_dft import range_rows
from isacbench.errors import InputError, InputWarning
from isacbench.model.echo import resource_grid
from isacbench.model.region import Region
from isacbench.plugins.registry import get_estimator

from .test_path_lengths import scenario_of

SCENARIO = scenario_of(("-u", "-w"))
N, M = SCENARIO.system.n_subcarriers, SCENARIO.system.n_symbols
FRAME = resource_grid(SCENARIO, SCENARIO.array.positions, slice(0, N)).reshape(N, M, *SCENARIO.array.shape)
NEARBY = replace(SCENARIO, region=Region((-10.0, 10.0), (0.0, 30.0), (0.0, 10.0), (-40.0, 40.0)))
NULLS = {
    "DC": [64],
    "guard carriers": [*range(10), *range(118, 128)],
    "both": [*range(12), 64, *range(117, 128)],
    "a gap": [*range(60, 66)],
}


def received(nulls, seed=0):
    """Frame with noise at 0 dB, and a QPSK grid with null carriers."""
    rng = np.random.default_rng(seed)
    grid = np.exp(0.5j * np.pi * rng.integers(4, size=(N, M)))
    grid[nulls] = 0
    noise = rng.standard_normal((2, *FRAME.shape)) / np.sqrt(2)
    return FRAME * grid[:, :, None, None] + noise[0] + 1j * noise[1], grid


def echo_of(range_bins):
    """Echoes (n, ...) of unit amplitude in range bins."""
    return np.exp(-2j * np.pi * np.multiply.outer(np.arange(N), range_bins) / N)


def away(range_bin, grid):
    """Echo of unit amplitude in a range bin beyond the region."""
    return (echo_of(range_bin)[:, None] * grid)[:, :, None, None]


def all_but(nulls):
    used = np.ones(N, dtype=bool)
    used[nulls] = False
    return used


@pytest.mark.parametrize("division", ["reciprocal", "matched", "wiener"])
@pytest.mark.parametrize("nulls", NULLS)
def test_null_carriers_make_no_false_points(nulls, division):
    frame, grid = received(NULLS[nulls])
    snr = {"snr_db": 0.0} if division == "wiener" else {}
    cloud = get_estimator("music2d").estimate(observe_cube(frame, SCENARIO, grid, division=division, **snr))
    np.testing.assert_allclose(cloud.xyz, SCENARIO.scatterers.xyz, atol=0.15)
    np.testing.assert_allclose(cloud.velocity, SCENARIO.scatterers.velocity, atol=0.1)


def test_guard_carriers_narrow_the_band_and_leave_the_power_of_an_echo():
    frame, grid = received(NULLS["guard carriers"])
    seen = observe_cube(frame, SCENARIO, grid)
    assert seen.system.n_subcarriers == N - 20
    assert seen.system.carrier_hz == SCENARIO.system.carrier_hz + 10 * SCENARIO.system.subcarrier_spacing_hz
    assert get_estimator("esprit2d").estimate(seen).power == pytest.approx([1.0], rel=0.05)


def test_what_null_carriers_hold_does_not_matter():
    frame, grid = received(NULLS["both"])
    is_null = (grid == 0)[:, :, None, None]
    frames = frame + 9.0 * is_null, np.where(is_null, 0, frame)
    np.testing.assert_array_equal(*(observe_cube(one, SCENARIO, grid).cells for one in frames))


@pytest.mark.parametrize("rounding", [1e-12, 3e-8])
def test_null_carriers_may_hold_what_a_transform_rounds_and_the_frame_nothing(rounding):
    frame, grid = received(NULLS["both"])
    expected = observe_cube(frame, SCENARIO, grid).cells
    is_null = grid == 0
    frame[is_null] = np.nan
    observation = observe_cube(frame, SCENARIO, grid + rounding * is_null, sensing="all")
    np.testing.assert_array_equal(observation.cells, expected)
    frame[70, 3, 2, 1] = np.nan
    with pytest.raises(InputError, match=r"nan.* at subcarrier 70, symbol 3, element \(2, 1\)"):
        _ = observe_cube(frame, SCENARIO, grid).cells


@pytest.mark.parametrize("nulls", [[64], [20, 50, 80, 110]])
@pytest.mark.parametrize("range_bin", [40.0, 60.0, 90.0, 126.0])
def test_strong_echoes_from_beyond_the_region_make_no_false_points(range_bin, nulls):
    frame, grid = received(nulls)
    seen = observe_cube(frame + 10 * away(range_bin, grid), NEARBY, grid)
    cloud = get_estimator("music2d").estimate(seen)
    np.testing.assert_allclose(cloud.xyz, SCENARIO.scatterers.xyz, atol=0.3)


@pytest.mark.parametrize("nulls", [[64], [63, 64], [*range(60, 66)]])
@pytest.mark.parametrize("limits", [(5.0, 25.0), (20.0, 35.0), (40.0, 60.0)])
def test_the_transmitter_s_own_signal_leaves_no_false_ranges(nulls, limits):
    rows = range_rows(np.arange(N), N)
    difference = interpolate_nulls(all_but(nulls), limits).interpolated(rows) - rows
    assert np.abs(difference @ echo_of([-0.4, 0.0, 1.3])).max() < 10 ** (-55 / 20) * np.sqrt(N)


@pytest.mark.parametrize("place", [3.0, 7.4, 11.8])
def test_an_interpolated_carrier_holds_what_the_echo_would_have_there(place):
    used = all_but([40, 41, 64])
    rows, echo = range_rows(np.arange(0, 15), N), echo_of(place)
    nulls = interpolate_nulls(used, (0.0, 14.0))
    interpolated = nulls.interpolated(rows)
    assert nulls.missed <= 1e-3
    assert not interpolated[:, ~used].any()
    np.testing.assert_allclose(interpolated @ echo, rows @ echo, atol=1e-3 * np.sqrt(N))
    # Left at 0, they are missed.
    assert np.abs((rows * used) @ echo - rows @ echo).max() > 0.1


@pytest.mark.parametrize(
    ("zeros", "sensing"),
    [((5, 7), "all"), ((slice(None), 3), "all"), ((slice(None), slice(None)), "all"), (60, "prs")],
)
def test_other_zeros_are_refused_for_every_division(zeros, sensing):
    frame, grid = received([])
    grid[zeros] = 0
    message = r"is 0\+0j at subcarrier \d+, symbol \d+; allowed are finite numbers, and 0 only"
    with pytest.raises(InputError, match=message):
        observe_cube(frame, SCENARIO, grid, division="matched", sensing=sensing)


def test_what_the_interpolation_misses_is_less_than_it_says():
    rows = range_rows(np.arange(N), N)
    nulls = interpolate_nulls(all_but(slice(50, 62)), (0.0, 30.0))
    echoes = echo_of(30 * (np.arange(600) + 0.5) / 600)
    errors = np.abs((nulls.interpolated(rows) - rows) @ echoes).max(axis=0) / np.sqrt(N)
    assert 0.1 * nulls.missed < np.sqrt(np.mean(errors**2)) < nulls.missed


def test_carriers_of_little_power_are_told_where_the_division_raises_their_noise():
    cube, grid = received(NULLS["guard carriers"])
    grid[NULLS["guard carriers"]] = 1e-3
    with pytest.warns(InputWarning, match="array: 20 subcarriers from 0 on have less than -30 dB"):
        observe_cube(cube, SCENARIO, grid)
    observe_cube(cube, SCENARIO, grid, division="matched")  # which warns of nothing


def test_a_comb_tells_that_echoes_from_beyond_the_region_fold_into_it():
    frame, grid = received([n for n in range(N) if n % 4])
    message = r"up to -\d\d dB of an echo from the region, up to -?\d dB of one from be"
    with pytest.warns(InputWarning, match=message):
        observe_cube(frame, NEARBY, grid)


@pytest.mark.parametrize(("nulls", "is_told"), [([64], False), ([62, 63, 64], True)])
def test_the_summary_tells_of_strong_echoes_whose_false_ranges_reach_the_region(nulls, is_told):
    frame, grid = received(nulls)
    sentences = summarise_frame(observe_cube(frame + 10 * away(60, grid), NEARBY, grid)).sentences()
    assert any("false ranges up to -1" in sentence for sentence in sentences) == is_told


@pytest.mark.parametrize(
    ("nulls", "of_region_db", "of_beyond_db"),
    [([64], -94, -55), ([63, 64], -63, -34), ([*range(60, 66)], -47, -14), ([20, 50, 80, 110], -82, -48)],
)
def test_the_levels_of_false_ranges_are_those_of_the_page(nulls, of_region_db, of_beyond_db):
    found = interpolate_nulls(all_but(nulls), (10.0, 30.0))
    levels_db = 20 * np.log10([found.missed, found.missed_beyond])
    assert levels_db == pytest.approx([of_region_db, of_beyond_db], abs=0.6)
