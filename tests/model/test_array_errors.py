"""Errors of the virtual elements: their draw, and that every way to an echo has them."""

import dataclasses
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench import get_estimator, load_scenario, observe
from isacbench.bench.suites.scenario_digest import (
    describe_scenario,
    restore_scenario,
    scenario_digest,
    truth_table,
)
from isacbench.errors import InputError
from isacbench.model.array import VirtualArray, element_errors
from isacbench.model.echo import Simulator, resource_grid
from tests.gated_cells import cells_in_gate
from tests.link.sensing.echo_waveform import waveform_cells

GOLDEN = [0.9673036823 - 0.0883890767j, 0.8553349961 + 0.2097184341j]
SMALL = VirtualArray((1, 1), (5, 4))
SYSTEM = dataclasses.replace(load_scenario("single").system, n_subcarriers=512, n_symbols=56)


def erring(name="single", gain_error_db=0.5, phase_error_deg=5.0, **others):
    return dataclasses.replace(
        load_scenario(name), gain_error_db=gain_error_db, phase_error_deg=phase_error_deg, **others
    )


@given(st.text(max_size=10), st.integers(1, 20))
def test_an_element_has_one_error_whatever_elements_are_asked_for(name, n):
    of_all = element_errors(name, 0.5, 5.0, SMALL.positions)
    np.testing.assert_array_equal(element_errors(name, 0.5, 5.0, SMALL.positions[-n:]), of_all[-n:])


@given(st.floats(0.01, 3), st.floats(0.1, 40))
def test_errors_scale_with_their_standard_deviations(gain_error_db, phase_error_deg):
    unit = element_errors("street", 1.0, 1.0, SMALL.positions)
    factors = element_errors("street", gain_error_db, phase_error_deg, SMALL.positions)
    np.testing.assert_allclose(np.log(np.abs(factors)), gain_error_db * np.log(np.abs(unit)), atol=1e-12)
    expected = np.exp(1j * phase_error_deg * np.angle(unit))
    np.testing.assert_allclose(factors / np.abs(factors), expected, atol=1e-9)


def test_errors_are_independent_normal_numbers():
    """Of 20 scenes with 256 elements each: mean, variance, correlation and tails within four deviations."""
    elements = VirtualArray().positions
    factors = np.concatenate([element_errors(f"scene {k}", 1.0, 1.0, elements) for k in range(20)])
    gain, phase = 20 * np.log10(np.abs(factors)), np.degrees(np.angle(factors))
    n = gain.size
    for values in (gain, phase):
        assert abs(values.mean()) < 4 / np.sqrt(n)
        assert abs(values.var() - 1) < 4 * np.sqrt(2 / n)
        assert abs((np.abs(values) > 2).mean() - 0.0455) < 4 * np.sqrt(0.0455 / n)
        assert abs(np.corrcoef(values[1:], values[:-1])[0, 1]) < 4 / np.sqrt(n)
    assert abs(np.corrcoef(gain, phase)[0, 1]) < 4 / np.sqrt(n)


def test_errors_are_the_same_as_years_ago():
    factors = element_errors("town[seed=7]", 0.5, 5.0, [[0, 0], [15, 15]])
    np.testing.assert_allclose(factors, GOLDEN, atol=1e-9)


def test_closed_form_resource_grid_waveform_and_sensing_agree_on_errors():
    scenario = erring("sparse[seed=3]", system=SYSTEM, array=SMALL)
    observed = Simulator(scenario).observe(np.inf)
    cells = cells_in_gate(resource_grid(scenario, scenario.array.positions), observed.gate)
    np.testing.assert_allclose(cells.reshape(observed.cells.shape), observed.cells, atol=1e-8)
    waveform = waveform_cells(scenario)
    scale = np.abs(observed.cells).max()
    assert np.abs(waveform - observed.cells).max() < 3e-3 * scale
    perfect = waveform_cells(dataclasses.replace(scenario, gain_error_db=0.0, phase_error_deg=0.0))
    assert np.abs(perfect - observed.cells).max() > 1e-2 * scale


@pytest.mark.parametrize("sensing", ["all", "prs"])
def test_errors_multiply_the_echo_of_every_element_and_leave_the_noise(sensing):
    scenario = erring("street", array=SMALL)
    perfect = dataclasses.replace(load_scenario("street"), array=SMALL)
    factors = element_errors("street", 0.5, 5.0, SMALL.positions).reshape(SMALL.shape)
    clean, plain = (observe(one, np.inf, sensing=sensing).cells for one in (scenario, perfect))
    scale = np.abs(plain).max()
    np.testing.assert_allclose(clean, plain * factors, atol=1e-9 * scale)
    noisy, plain_noisy = (observe(one, 10.0, sensing=sensing).cells for one in (scenario, perfect))
    np.testing.assert_allclose(noisy - clean, plain_noisy - plain, atol=1e-9 * scale)


def test_an_observation_does_not_hold_the_errors():
    with_errors, without = (observe(one, 10.0) for one in (erring(), load_scenario("single")))
    for field in dataclasses.fields(with_errors):
        if field.name not in ("cells", "gate"):
            assert repr(getattr(with_errors, field.name)) == repr(getattr(without, field.name))


def test_errors_are_part_of_a_scenario_s_identity_and_are_restored():
    scenario = erring("street")
    assert scenario_digest(scenario) != scenario_digest(load_scenario("street"))
    again = restore_scenario("street", describe_scenario(scenario), truth_table(scenario))
    assert (again.gain_error_db, again.phase_error_deg) == (0.5, 5.0)
    assert scenario_digest(again) == scenario_digest(scenario)


def file_with(keys, tiny):
    """File of a scene whose array has further keys."""
    tiny.write_text(tiny.read_text().replace('frame = "panel"', f'frame = "panel"\n{keys}'))
    return tiny


def test_a_file_and_a_family_give_the_errors(tiny):
    perfect = load_scenario(tiny)
    from_file = load_scenario(file_with("gain_error_db = 0.5\nphase_error_deg = 5", tiny))
    generated = load_scenario("town[seed=7,gain_error_db=0.5,phase_error_deg=5]")
    for scenario in (from_file, generated):
        assert (scenario.gain_error_db, scenario.phase_error_deg) == (0.5, 5.0)
    assert (perfect.gain_error_db, perfect.phase_error_deg) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("key", "value"),
    [("gain_error_db", -0.5), ("gain_error_db", 10.1), ("phase_error_deg", 181), ("phase_error_deg", np.nan)],
)
def test_an_impossible_error_is_refused_by_key_and_value_and_of_a_file_by_its_name(tiny, key, value):
    with pytest.raises(InputError, match=key):
        erring(**{key: value})
    path = file_with(f"{key} = {value}", tiny)
    with pytest.raises(InputError, match=f"^{re.escape(str(path))}: .*array.{key} = {value}"):
        load_scenario(path)


def test_errors_change_the_image_of_an_estimator_little():
    """A scatterer seen by 256 elements with errors of 0.5 dB and 5 degrees moves by centimetres."""
    name = "sparse[seed=3,scatterers=1]"
    scenes = dataclasses.replace(load_scenario(name), system=SYSTEM), erring(name, system=SYSTEM)
    clouds = [get_estimator("nomp4d").estimate(observe(scene, 25.0)).to_array() for scene in scenes]
    assert len(clouds[0]) >= 1
    assert not np.array_equal(*clouds)
    strongest = [cloud[cloud[:, 4].argmax(), :4] for cloud in clouds]
    np.testing.assert_allclose(*strongest, atol=0.1)
