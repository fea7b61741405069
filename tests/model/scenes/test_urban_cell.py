"""The family ``uma-av``: the geometry of TR 38.901, always the same, and a link budget of its own."""

import math

import numpy as np
import pytest
from scipy import stats

from isacbench import load_scenario
from isacbench.bench.suites.scenario_digest import (
    describe_scenario,
    restore_scenario,
    scenario_digest,
    truth_table,
)
from isacbench.model.scenes.scene_families import UmaAvParameters
from isacbench.model.scenes.urban_cell import HEIGHTS_M, draw_uma_av
from tests.conftest import refusal


def drawn(n, **options):
    """Places and velocities of the drones of many drops, without loading them."""
    tables = [draw_uma_av(UmaAvParameters(seed=seed, **options), f"key {seed}") for seed in range(n)]
    return [[(one["position_m"], one["velocity_mps"]) for one in table["objects"]] for table in tables]


def test_a_drop_is_the_same_as_years_ago():
    assert scenario_digest(load_scenario("uma-av[seed=7]")) == "f081d6d9b4284492"


def test_drones_are_anywhere_in_a_sector_of_a_hexagon_ten_metres_apart():
    drops = drawn(300)
    for drones in drops:
        places = [place for place, _ in drones]
        assert all(math.dist(a, b) >= 10 for i, a in enumerate(places) for b in places[:i])
    x, y, z = np.array([place for drones in drops for place, _ in drones]).T
    azimuth, ground = np.degrees(np.arctan2(x, -y)), np.hypot(x, y)
    assert np.abs(azimuth).max() <= 60
    assert ground.min() >= 10
    for side in (-60, 0, 60):
        assert (ground * np.cos(np.radians(azimuth - side))).max() <= 250
    # Uniform in area: the share within half of the way to the sides is a quarter.
    to_side = np.max([ground * np.cos(np.radians(azimuth - side)) for side in (-60, 0, 60)], axis=0)
    assert np.mean(to_side < 125) == pytest.approx(0.25, abs=0.04)
    assert stats.kstest(z, "uniform", (HEIGHTS_M[0], np.ptp(HEIGHTS_M))).pvalue > 1e-3


def test_drones_fly_horizontally_at_any_speed_up_to_180_km_h():
    velocity = np.array([one for drones in drawn(300) for _, one in drones])
    assert not velocity[:, 2].any()
    assert stats.kstest(np.hypot(*velocity[:, :2].T), "uniform", (0, 50)).pvalue > 1e-3


def test_movers_on_the_ground_are_clutter_and_leave_the_drones_as_they_are():
    plain, among = load_scenario("uma-av[seed=7]"), load_scenario("uma-av[seed=7,clutter=ground]")
    n = len(plain.scatterers)
    np.testing.assert_array_equal(among.scatterers.xyz[:n], plain.scatterers.xyz)
    np.testing.assert_allclose(among.scatterers.amplitude[:n], plain.scatterers.amplitude)
    assert among.scatterers.is_clutter.tolist() == [False] * n + [True] * (len(among.scatterers) - n)
    assert among.scatterers.xyz[n:, 2].max() <= 1


def test_more_power_is_as_many_decibels_more_of_each_echo():
    strong, weak = (load_scenario(f"uma-av[seed=7,tx_power_dbm={power}]") for power in ("52.0", "37.0"))
    np.testing.assert_allclose(strong.truth.power / weak.truth.power, 10**1.5)


def test_drops_differ_in_cross_sections_and_paths():
    first, second = (load_scenario(f"uma-av[seed={seed}]") for seed in (1, 2))
    scaled = [np.sort(one.truth.power * one.range_m**4) for one in (first, second)]
    assert not np.isclose(*scaled, rtol=1e-3).any()


@pytest.mark.parametrize(
    "name", ["uma-av[seed=7]", "uma-av[seed=7,targets=0]", "uma-av[seed=3,clutter=ground]"]
)
def test_a_stored_description_gives_the_drop_again(name):
    scenario = load_scenario(name)
    restored = restore_scenario(name, describe_scenario(scenario), truth_table(scenario))
    assert restored.budget == scenario.budget
    assert restored.frame == scenario.frame
    assert restored.system == scenario.system
    np.testing.assert_allclose(restored.scatterers.amplitude, scenario.scatterers.amplitude)
    assert restored.scatterers.is_clutter.tolist() == scenario.scatterers.is_clutter.tolist()


def test_parameters_of_other_families_are_refused():
    assert "no parameter 'frame'" in refusal(load_scenario, "uma-av[seed=1,frame=panel]")
    assert "targets = 51" in refusal(load_scenario, "uma-av[seed=1,targets=51]")


def test_a_scenario_shows_what_is_unlike_the_default():
    text = repr(load_scenario("uma-av[seed=1]"))
    assert "PRS comb 4, 12 symbols, one slot in 1; ambiguous off broadside from 14.5° along w" in text
    assert "PRS" not in repr(load_scenario("street"))
