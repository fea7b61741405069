import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.bench.kinds.power_maps import MAPS, SITE, draw_power_map, near
from isacbench.plugins.registry import get_detector

N_SITES = 128


@pytest.fixture(scope="module")
def maps():
    return {name: draw_power_map(name, 0, 0) for name in MAPS}


@given(
    cells=st.lists(st.tuples(st.integers(0, 8), st.integers(0, 11)), min_size=1, max_size=4),
    distance=st.integers(0, 3),
)
def test_near_is_the_square_around_each_cell(cells, distance):
    mask = np.zeros((9, 12), dtype=bool)
    mask[tuple(np.reshape(cells, (-1, 2)).astype(int).T)] = True
    away = [max(abs(row - r), abs(column - c)) for row, column in np.ndindex(9, 12) for r, c in cells]
    expected = (np.reshape(away, (9, 12, -1)) <= distance).any(axis=2)
    np.testing.assert_array_equal(near(mask, distance), expected)


def test_only_targets_and_interferers_have_an_echo(maps):
    echoes = {name: np.count_nonzero(drawn.echo) for name, drawn in maps.items()}
    targets = {name: int(drawn.targets.sum()) for name, drawn in maps.items()}
    assert targets == {
        "homogeneous": N_SITES,
        "clutter-edge": N_SITES // 2,
        "close-targets": 2 * N_SITES,
        "interferers": N_SITES,
    }
    assert echoes == targets | {"interferers": 7 * N_SITES}
    for drawn in maps.values():
        assert not (drawn.clear & (drawn.echo != 0)).any()
    # Those of the homogeneous map are counted where no window sees a target.
    drawn = maps["homogeneous"]
    assert not (drawn.clear & near(drawn.targets, 8)).any()
    assert drawn.clear.mean() > 0.5


@pytest.mark.parametrize("name", ["close-targets", "interferers"])
def test_neighbours_lie_two_to_four_cells_away(maps, name):
    echo = maps[name].echo != 0
    for row in range(SITE // 2, echo.shape[0], SITE):
        for column in range(SITE // 2, echo.shape[1], SITE):
            site = np.argwhere(echo[row - 8 : row + 9, column - 8 : column + 9]) - 8
            distance = np.abs(site).max(axis=1)
            assert sorted(distance)[0] == 0
            assert set(distance) <= {0, 2, 3, 4}


def test_the_clutter_edge_is_a_step_with_targets_before_it_and_false_alarms_counted_on_it(maps):
    drawn = maps["clutter-edge"]
    power = np.mean(np.abs(drawn.noise) ** 2, axis=1)
    clutter = power > 8
    np.testing.assert_allclose(power[clutter], 10**1.5, rtol=0.25)
    np.testing.assert_allclose(power[~clutter], 1, rtol=0.25)
    assert clutter.sum() == clutter.size // 2
    for row in np.flatnonzero(drawn.targets.any(axis=1)):
        assert clutter[row : row + 4].tolist() == [False, False, False, True]
    rows = np.flatnonzero(drawn.clear.any(axis=1))
    assert clutter[rows].all()
    assert all(not clutter[row - 4 : row].all() for row in rows)


def test_noise_and_echoes_are_gaussian_of_unit_power(maps):
    drawn = maps["homogeneous"]
    assert np.mean(np.abs(drawn.noise) ** 2) == pytest.approx(1, abs=5 / np.sqrt(drawn.noise.size))
    # Of an exponential power the fourth moment is twice the square of the second.
    assert np.mean(np.abs(drawn.noise) ** 4) == pytest.approx(2, abs=0.1)
    echo = drawn.echo[drawn.targets]
    assert np.mean(np.abs(echo) ** 2) == pytest.approx(1, abs=5 / np.sqrt(echo.size))


def test_the_snr_scales_the_echo_and_leaves_the_noise(maps):
    drawn = maps["homogeneous"]
    low, high = drawn.power(-300.0), drawn.power(200.0)
    np.testing.assert_allclose(low, np.abs(drawn.noise) ** 2)
    quiet = ~drawn.targets
    np.testing.assert_array_equal(low[quiet], high[quiet])
    np.testing.assert_allclose(high[drawn.targets], 1e20 * np.abs(drawn.echo[drawn.targets]) ** 2, rtol=1e-6)


def test_a_map_follows_from_name_trial_and_seed():
    first = draw_power_map("interferers", 1, 2)
    again = draw_power_map("interferers", 1, 2)
    np.testing.assert_array_equal(first.noise, again.noise)
    np.testing.assert_array_equal(first.echo, again.echo)
    for other in (draw_power_map("interferers", 0, 2), draw_power_map("interferers", 1, 0)):
        assert not np.array_equal(first.noise, other.noise)
        assert not np.array_equal(first.echo != 0, other.echo != 0)


@pytest.mark.parametrize("snr_db", [5.0, 12.0, 20.0])
def test_cell_averaging_on_the_homogeneous_map_detects_as_often_as_its_closed_form_says(snr_db):
    detector, snr = get_detector("ca", pfa=1e-3), 10 ** (snr_db / 10)
    counts = np.zeros(4)
    for trial in range(6):
        drawn = draw_power_map("homogeneous", trial, 0)
        mask = detector.detect(drawn.power(snr_db)).mask
        counts += [
            np.sum(one) for one in (mask & drawn.targets, drawn.targets, mask & drawn.clear, drawn.clear)
        ]
    hits, targets, false, clear = counts
    expected = (1 + (1e-3 ** (-1 / 72) - 1) / (1 + snr)) ** -72
    assert hits / targets == pytest.approx(expected, abs=4 * np.sqrt(expected * (1 - expected) / targets))
    # Cells share training cells: their false alarms are not independent.
    assert false / clear == pytest.approx(1e-3, rel=0.2)
