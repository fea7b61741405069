"""Leakage: the transmitters' own signal at the receivers, half a range bin away, and what it reaches."""

import dataclasses

import numpy as np
import pytest

from isacbench.bench.suites.scenario_digest import scenario_digest
from isacbench.errors import InputError
from isacbench.link.sensing.observing import observe
from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator, clean_echo, resource_grid
from isacbench.model.scenes.scenario import load_scenario
from tests.gated_cells import cells_in_gate, gate_of

ARRAY = VirtualArray((2, 2), (2, 2), 2, 1)


@pytest.fixture
def leaking(make_scenario):
    """Return a function that builds scenes whose transmitters leak."""

    def build(leakage_db, mimo="ideal"):
        array = dataclasses.replace(ARRAY, leakage_db=leakage_db, mimo=mimo)
        return make_scenario(array=array, n_subcarriers=240, n_symbols=112)

    return build


def test_the_direct_path_is_a_static_echo_half_a_bin_away_with_the_phases_of_elements(leaking):
    scenario, without = leaking(30.0), leaking(None)
    own = resource_grid(scenario, ARRAY.positions) - resource_grid(without, ARRAY.positions)
    amplitude = 10**1.5 * scenario.scatterers.total_amplitude
    expected = amplitude * np.exp(-2j * np.pi * np.arange(240) * 0.5 / 240)
    for element in range(len(ARRAY.positions)):
        of_element = own[:, :, element] / expected[:, None]
        np.testing.assert_allclose(np.abs(of_element), 1, atol=1e-9)
        np.testing.assert_allclose(of_element, np.full((240, 112), of_element[0, 0]), atol=1e-9)
    # From no direction: no plane wave has more than a share of its power.
    beams = np.fft.fft2(own[0, 0].reshape(4, 4))
    assert np.abs(beams).max() ** 2 < 0.7 * np.sum(np.abs(beams) ** 2)


@pytest.mark.parametrize("mimo", ["ideal", "comb", "tdm"])
def test_cells_are_the_transform_of_the_grid(leaking, mimo):
    scenario = leaking(40.0, mimo)
    gate = gate_of(scenario)
    cells = scenario.array.n_turns * cells_in_gate(resource_grid(scenario, ARRAY.positions), gate)
    found = clean_echo(scenario, gate).reshape(cells.shape)
    np.testing.assert_allclose(found, cells, atol=1e-9 * np.abs(cells).max())


def test_sidelobes_fall_with_the_inverse_range_and_no_mover_meets_them(leaking):
    scenario, without = leaking(30.0), leaking(None)
    gate = gate_of(scenario)
    power = np.mean(np.abs(clean_echo(scenario, gate) - clean_echo(without, gate)) ** 2, axis=(2, 3))
    peak = 1e3 * scenario.scatterers.total_amplitude**2 * scenario.system.processing_gain
    distance = gate.range_bins - 0.5
    expected = peak / (240 * np.sin(np.pi * distance / 240)) ** 2
    np.testing.assert_allclose(power[:, gate.doppler_bins == 0][:, 0], expected, rtol=1e-6)
    assert power[:, gate.doppler_bins != 0].max() < 1e-9 * expected.min()


def test_the_snr_is_that_of_the_echoes_whatever_leaks(leaking):
    assert Simulator(leaking(60.0)).noise_power(7.0) == Simulator(leaking(None)).noise_power(7.0)


def test_sensing_with_part_of_the_grid_has_leakage(leaking):
    scenario = leaking(30.0)
    with_leakage = observe(scenario, np.inf, sensing="prs").cells
    assert np.abs(with_leakage - observe(leaking(None), np.inf, sensing="prs").cells).max() > 1
    with pytest.raises(InputError, match=r"array\.leakage_db = 201"):
        VirtualArray(leakage_db=201.0)


def test_leakage_and_dynamic_range_are_parameters_of_families(leaking):
    assert scenario_digest(leaking(None)) != scenario_digest(leaking(0.0))
    town, leaky = load_scenario("town[seed=101]"), load_scenario("town[seed=101,leakage_db=40]")
    assert (town.array.leakage_db, leaky.array.leakage_db) == (None, 40.0)
    np.testing.assert_array_equal(leaky.scatterers.xyz, town.scatterers.xyz)
    ranges = [*(f",dynamic_range_db={limit_db}" for limit_db in (0, 20, 40)), ""]
    flat, low, high, plain = (load_scenario(f"weak[seed=101{key}]").scatterers.amplitude for key in ranges)
    np.testing.assert_array_equal(high, plain)
    assert (flat == 1).all()
    np.testing.assert_allclose(low, np.sqrt(high), atol=2e-3)
