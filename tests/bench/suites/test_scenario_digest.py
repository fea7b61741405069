"""Digests of contents: equal for what is equal, whoever wrote it; other for all that rows follow from."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.bench.suites.scenario_digest import (
    canonical_json,
    describe_scenario,
    digest,
    restore_scenario,
    scenario_digest,
    truth_table,
)
from isacbench.errors import InputWarning
from isacbench.model.frame import PanelFrame
from isacbench.model.numerology import Prs
from isacbench.model.scenes.scenario import load_scenario

json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@given(json_values)
def test_canonical_json_is_json_of_the_same_content(content):
    assert json.loads(canonical_json(content)) == content


@given(st.dictionaries(st.text(), st.integers(), min_size=2, max_size=5))
def test_the_order_of_keys_is_no_content(content):
    backwards = dict(reversed(content.items()))
    assert digest(backwards) == digest(content)


def test_what_is_no_number_has_no_digest():
    with pytest.raises(ValueError, match="not JSON compliant"):
        digest([float("nan")])


@pytest.fixture
def scenario(tiny):
    return load_scenario(tiny)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("# Three points in a small scene.", "# Another remark."),
        ("[5.0, 40.0, 10.0]", "[5, 4.0e1, 10.000]"),
        ("n_symbols = 32", "n_symbols = 32\ncarrier_hz = 70e9"),
        ("[system]", "[scoring]\nradius_m = 1\n[system]"),
        ("[system]", "[prs]\ncomb = 4\nn_symbols = 12\nfirst_symbol = 1\nperiod = 4\noffset = 0\n[system]"),
    ],
)
def test_how_a_scenario_is_written_is_not_its_content(tiny, scenario, old, new):
    tiny.write_text(tiny.read_text().replace(old, new))
    assert scenario_digest(load_scenario(tiny)) == scenario_digest(scenario)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('name = "tiny"', 'name = "small"'),
        ("n_subcarriers = 256", "n_subcarriers = 255"),
        ("n_symbols = 32", "n_symbols = 32\ncoherent_phase = false"),
        ("rx_shape = [4, 4]", "rx_shape = [4, 3]"),
        ('frame = "panel"', 'frame = "panel"\ntilt_deg = 1'),
        ("[5.0, 40.0, 10.0]", "[5.0, 40.0, 10.001]"),
        ("z_m = [0.0, 5.0]", "z_m = [0.0, 5.5]"),
        ("speed_mps = [-15.0, 15.0]", "speed_mps = [-15.0, 16.0]"),
        ("[system]", "[scoring]\nradius_m = 2\n[system]"),
        ("[system]", "[prs]\ncomb = 2\n[system]"),
        ("[system]", "[prs]\nperiod = 5\n[system]"),
    ],
)
def test_everything_that_an_observation_follows_from_is_content(tiny, scenario, old, new):
    text = tiny.read_text()
    assert old in text
    tiny.write_text(text.replace(old, new))
    assert scenario_digest(load_scenario(tiny)) != scenario_digest(scenario)


@pytest.mark.parametrize("field", ["xyz", "velocity", "amplitude", "phase_rad"])
def test_every_scatterer_is_content_to_a_part_in_a_thousand_million(scenario, field):
    scatterers = scenario.scatterers
    values = np.array(getattr(scatterers, field)) + 0.01
    changed = values * (1 + 1e-8)

    def content(array):
        return scenario_digest(
            dataclasses.replace(scenario, scatterers=dataclasses.replace(scatterers, **{field: array}))
        )

    assert content(changed) != content(values)
    # The last digits of a sine differ between machines.
    assert content(values * (1 + 1e-15)) == content(values)


def test_minus_nothing_is_nothing(scenario):
    still = dataclasses.replace(scenario.scatterers, velocity=np.zeros(3))
    backwards = dataclasses.replace(scenario.scatterers, velocity=-np.zeros(3))
    one, other = (dataclasses.replace(scenario, scatterers=found) for found in (still, backwards))
    assert scenario_digest(one) == scenario_digest(other)


def test_a_scenario_is_restored_without_repeating_its_warnings(tiny):
    (tiny.parent / "tiny.csv").write_text("x,y,z,v\n1,2,3,0\n1,2,6,0\n")
    with pytest.warns(InputWarning):
        scenario = load_scenario(tiny)
    restore_scenario(scenario.name, describe_scenario(scenario), truth_table(scenario))


@pytest.mark.parametrize("name", ["street", None])
def test_a_described_scenario_is_restored(tiny, name):
    scenario = load_scenario(name or tiny)
    described = json.loads(json.dumps(describe_scenario(scenario)))
    restored = restore_scenario(scenario.name, described, truth_table(scenario))
    assert scenario_digest(restored) == scenario_digest(scenario)


@pytest.mark.parametrize("radius_m", [1.0, 2.5])
def test_a_key_that_is_left_out_at_one_value_is_restored_with_any(tiny, radius_m):
    scenario = dataclasses.replace(load_scenario(tiny), radius_m=radius_m)
    described = describe_scenario(scenario)
    assert ("radius_m" in described) == (radius_m != 1)
    again = restore_scenario("tiny", described, truth_table(scenario))
    assert again.radius_m == radius_m
    assert scenario_digest(again) == scenario_digest(scenario)


@pytest.mark.parametrize("spacing", [(0.5, 0.5), (0.5, 0.8)])
def test_a_scenario_is_restored_with_the_spacing_of_its_elements(scenario, spacing):
    scenario = dataclasses.replace(scenario, frame=PanelFrame(3.0, 4.0, spacing))
    described = json.loads(json.dumps(describe_scenario(scenario)))
    assert ("spacing_wavelengths" in described["frame"]) == (spacing != (0.5, 0.5))
    again = restore_scenario("tiny", described, truth_table(scenario))
    assert again.frame == scenario.frame
    assert scenario_digest(again) == scenario_digest(scenario)


@pytest.mark.parametrize("prs", [Prs(), Prs(2, 6, 3, 1)])
def test_a_scenario_is_restored_with_its_positioning_signal(scenario, prs):
    scenario = dataclasses.replace(scenario, system=dataclasses.replace(scenario.system, prs=prs))
    described = json.loads(json.dumps(describe_scenario(scenario)))
    assert described["system"].get("prs") == (None if prs == Prs() else dataclasses.asdict(prs))
    again = restore_scenario("tiny", described, truth_table(scenario))
    assert again.system == scenario.system
    assert scenario_digest(again) == scenario_digest(scenario)


@pytest.mark.parametrize("suite", ["quick", "paper"])
def test_scenarios_have_the_digests_that_committed_rows_know_them_by(suite):
    manifest = Path(__file__).parents[3] / "results" / "reference" / suite / "manifest.json"
    for name, described in json.loads(manifest.read_text())["scenarios"].items():
        assert scenario_digest(load_scenario(name)) == described["content"]
