"""Scenario files: the streets that ship, and one clear line for every mistake."""

import dataclasses

import numpy as np
import pytest
from typer.testing import CliRunner

from isacbench.bench.suites.scenario_digest import scenario_digest
from isacbench.cli import app
from isacbench.errors import InputError, InputWarning
from isacbench.files.toml_files import builtin_names
from isacbench.model.frame import PanelFrame, PaperFrame
from isacbench.model.numerology import Prs, System
from isacbench.model.scenes.scenario import load_scenario
from tests.conftest import refusal

STREETS = ("street", "street-coherent", "street-paper")
CAR = '[[objects]]\nkind = "car"\nposition_m = [5.0, 5.0, 0.0]\n'


@pytest.fixture(scope="module", params=STREETS)
def street(request):
    """Each of the three streets."""
    return load_scenario(request.param)


def test_the_streets_ship_and_differ_in_frame_and_phase_alone():
    assert set(STREETS) <= set(builtin_names())
    streets = [load_scenario(name) for name in STREETS]
    assert [scenario.name for scenario in streets] == [*STREETS]
    assert [scenario.frame for scenario in streets] == [PanelFrame(), PanelFrame(), PaperFrame()]
    assert [scenario.system.coherent_phase for scenario in streets] == [False, True, False]
    for scenario in streets[1:]:
        np.testing.assert_array_equal(scenario.truth.to_array(), streets[0].truth.to_array())


def test_the_street_has_the_papers_size_place_and_region(street):
    assert (street.system.n_subcarriers, street.system.n_symbols) == (2048, 224)
    assert street.array.shape == (16, 16)
    assert street.base_station_m.tolist() == [14, 100, 20]
    region = street.region
    assert (region.x_m, region.y_m, region.z_m) == ((0, 30), (0, 20), (0, 20))
    assert region.speed_mps == (-15, 15)


def test_the_street_has_466_distinct_unit_scatterers_all_inside_its_region(street):
    points = street.truth.to_array()
    assert len(np.unique(points, axis=0)) == len(points) == 466
    assert street.region.contains(points[:, :3]).all()
    assert (points[:, 4] == 1).all()


STREET = [
    (114, 10, (8, 10), (12, 18), (0, 1.8)),
    (114, -10, (18, 20), (2, 8), (0, 1.8)),
    (12, 2, (0.5, 1.5), (1.5, 2.5), (0, 1.8)),
    (12, 2, (1.5, 2.5), (12.5, 13.5), (0, 1.8)),
    (12, -2, (26.5, 27.5), (6.5, 7.5), (0, 1.8)),
    (12, -2, (26.5, 27.5), (17.5, 18.5), (0, 1.8)),
    (164, 0, (14, 15), (0, 20), (0, 1)),
    (13, 0, (14, 16), (2, 4), (2, 10)),
    (13, 0, (13, 15), (17, 19), (2, 10)),
]
"""Of each object: points, speed, and the limits of its box in x, y and z."""


def test_every_object_of_the_street_stands_in_its_box(street):
    for n_points, speed_mps, *box_m in STREET:
        low, high = np.transpose(box_m)
        inside = ((street.truth.xyz >= low - 1e-9) & (street.truth.xyz <= high + 1e-9)).all(axis=1)
        objects = street.truth.select(inside & (street.truth.velocity == speed_mps))
        assert len(objects) == n_points, box_m
        assert objects.xyz[:, 2].max() == pytest.approx(high[2])


def test_the_green_belt_is_four_lines_with_a_point_every_half_metre(street):
    static = street.truth.xyz[(street.truth.velocity == 0) & (street.truth.xyz[:, 2] < 2)]
    lines = {(x, y, z) for x in (14, 15) for y in np.arange(41) / 2 for z in (0, 1)}
    assert {tuple(point) for point in static} == lines


def test_omitted_keys_take_the_values_of_table_one(tiny):
    system = load_scenario(tiny).system
    assert system == System(n_subcarriers=256, n_symbols=32)


def test_points_are_shifted_and_scaled_by_their_object(tiny):
    tiny.write_text(tiny.read_text() + "position_m = [-1.0, 0.5, 1.0]\nvelocity_mps = 2.0\namplitude = 3.0\n")
    scatterers = load_scenario(tiny).scatterers
    np.testing.assert_allclose(scatterers.xyz, [[0, 2.5, 4], [4, 6.5, 2], [8, 9.5, 3]])
    assert scatterers.velocity.tolist() == [2, 12, -8]
    assert scatterers.amplitude.tolist() == [3, 6, 3]


def test_a_points_file_is_looked_up_beside_the_scenario_whatever_the_working_folder(tiny, monkeypatch):
    folder = tiny.parent / "data"
    folder.mkdir()
    (tiny.parent / "tiny.csv").rename(folder / "tiny.csv")
    tiny.write_text(tiny.read_text().replace("tiny.csv", "data/tiny.csv"))
    monkeypatch.chdir(folder)
    assert len(load_scenario(f"../{tiny.name}").scatterers) == 3
    assert len(load_scenario(tiny).scatterers) == 3


def test_objects_take_their_sizes_from_the_file(tiny):
    belt = '[[objects]]\nkind = "green_belt"\nposition_m = [5, 5, 0]\nsize_m = [1, 4, 2]\nspacing_m = 2\n'
    tiny.write_text(tiny.read_text() + belt)
    np.testing.assert_allclose(np.ptp(load_scenario(tiny).scatterers.xyz[3:], axis=0), [1, 4, 2])


def test_a_panel_takes_yaw_and_tilt(tiny):
    turned = 'frame = "panel"\nyaw_deg = 3\ntilt_deg = 5.5'
    tiny.write_text(tiny.read_text().replace('frame = "panel"', turned))
    assert load_scenario(tiny).frame == PanelFrame(3.0, 5.5)


@pytest.mark.filterwarnings("default")
def test_a_scatterer_outside_the_region_is_a_warning_and_on_the_command_line_one_line_without_source(tiny):
    points = tiny.parent / "tiny.csv"
    points.write_text("x,y,z,v\n1,2,3,0\n1,2,6,0\n")
    with pytest.warns(InputWarning, match="scenario tiny: 1 of 2 scatterers lie outside the region"):
        load_scenario(tiny)
    result = CliRunner().invoke(app, ["score", str(tiny), str(points)])
    assert result.exit_code == 0
    assert result.stderr == (
        "isacbench: warning: scenario tiny: 1 of 2 scatterers lie outside the region or its speeds, "
        "where no estimator looks\n"
    )


LAMP_POST, WALL = CAR.replace("car", "lamp_post"), CAR.replace("car", "wall")
SYMBOLS, KIND, PANEL = "n_symbols = 32", 'kind = "car"', 'frame = "panel"'
SPACING = "subcarrier_spacing_hz = -1.0"
SPARSE_ARRAY = (
    "array: the sum co-array of tx_shape (1, 1) at tx_spacing 8 and rx_shape (4, 4) at rx_spacing 2 "
    "fills 16 of 7 x 7 places; it must be a filled rectangle"
)
FAR = (
    "region: its farthest corner is 940.1 m from the base station, beyond the unambiguous range; "
    "allowed are at most 624.6 m"
)
FAST = "region.speed_mps: 300 m/s is beyond the unambiguous speed; allowed are at most 205.6 m/s"
BLIND = "region: it lies where the array is blind; allowed are places in front of the panel"
FINE = "objects[1]: spacing_m = 1e-09 divides 12 m into 1.2e+10 steps; allowed are at most 2000"
MANY = "objects[1]: its spacing_m makes 2163001 scatterers of one surface; allowed are at most 100000"
MISTAKES = {
    "unknown key system.n_symbol: did you mean 'n_symbols'? allowed are carrier": ("n_symbols", "n_symbol"),
    "unknown key objects[1].sise_m: did you mean 'size_m'? allowed are": (CAR, f"{CAR}sise_m = [1, 1, 1]\n"),
    "unknown key objects[1].car: allowed are position_m, velocity": (CAR, f"{CAR}car = 1\n"),
    "missing key name": ('name = "tiny"', ""),
    "missing key array.frame": (PANEL, ""),
    "missing key region.x_m[1]": ("x_m = [0.0, 10.0]", "x_m = [0.0]"),
    "missing key objects[1].kind": (KIND, ""),
    "objects[1].kind = 'carr': did you mean 'car'? allowed are box, car, ": (KIND, 'kind = "carr"'),
    "system.subcarrier_spacing_hz = -1.0: input should be greater than 0": (SYMBOLS, SPACING),
    "system.n_symbols = True: input should be a valid integer": (SYMBOLS, "n_symbols = true"),
    "system.n_symbols = 31.5: input should be a valid integer": (SYMBOLS, "n_symbols = 31.5"),
    "system.carrier_hz = nan: input should be a finite number": (SYMBOLS, "carrier_hz = nan"),
    "system.coherent_phase = 1: input should be a valid boolean": (SYMBOLS, "coherent_phase = 1"),
    "system.cyclic_prefix_ratio = 1.5: input should be less than or": (SYMBOLS, "cyclic_prefix_ratio = 1.5"),
    "prs.comb = 3: allowed is 2, 4, 6 or 12": ("[array]", "[prs]\ncomb = 3\n[array]"),
    "prs.n_symbols = 2: allowed is 4 or 12 with comb 4": ("[array]", "[prs]\nn_symbols = 2\n[array]"),
    "prs.period = 1.5: input should be a valid integer": ("[array]", "[prs]\nperiod = 1.5\n[array]"),
    "unknown key prs.combs: did you mean 'comb'?": ("[array]", "[prs]\ncombs = 4\n[array]"),
    "array.frame = 'flat': input should be 'paper' or 'panel'": (PANEL, 'frame = "flat"'),
    SPARSE_ARRAY: ("rx_shape = [4, 4]", "rx_shape = [4, 4]\nrx_spacing = 2"),
    "region.x_m = [10.0, 0.0]: must ascend, lower limit first": ("x_m = [0.0, 10.0]", "x_m = [10.0, 0.0]"),
    FAR: ("y_m = [0.0, 10.0]", "y_m = [-900.0, 10.0]"),
    FAST: ("speed_mps = [-15.0, 15.0]", "speed_mps = [-300.0, 15.0]"),
    BLIND: ("position_m = [5.0, 40.0, 10.0]", "position_m = [5.0, -40.0, 10.0]"),
    "objects[1]: lamp_post: foot_m = 12 must lie below height_m = 10": (CAR, f"{LAMP_POST}foot_m = 12.0\n"),
    FINE: (CAR, f"{WALL}spacing_m = 1e-9\n"),
    MANY: (CAR, f"{WALL}size_m = [900.0, 600.0]\n"),
    "objects[1].amplitude = 0.0: input should be greater than 0": (CAR, f"{CAR}amplitude = 0.0\n"),
    "not valid TOML: ": ("[array]", "[array"),
}
"""Start of a message, and what is put where in the file."""


def test_a_mistake_in_a_scenario_is_answered_with_file_key_and_what_is_allowed(tiny):
    text = tiny.read_text() + CAR
    for message, change in MISTAKES.items():
        tiny.write_text(text.replace(*change))
        assert refusal(load_scenario, tiny).startswith(f"{tiny}: {message}")


def test_a_file_says_which_positioning_signal_is_sent(tiny):
    assert load_scenario(tiny).system.prs == Prs()
    keys = "comb = 2\nn_symbols = 6\nfirst_symbol = 3\nperiod = 5\noffset = 2"
    tiny.write_text(tiny.read_text().replace("[array]", f"[prs]\n{keys}\n[array]"))
    assert load_scenario(tiny).system.prs == Prs(2, 6, 3, 5, 2)


def test_a_mistake_in_a_points_file_is_answered_with_both_files_and_the_row(tiny):
    points = tiny.parent / "tiny.csv"
    points.write_text("x,y,z,v\n1,2,3,0\n1,nan,3,0\n")
    message = "row 3: column y is nan; expected a finite number"
    assert refusal(load_scenario, tiny).startswith(f"{tiny}: objects[0]: {points}: {message}")


def test_an_unknown_scenario_is_answered_with_the_nearest_one_and_with_all_that_is_allowed():
    message = refusal(load_scenario, "streat")
    assert "unknown scenario 'streat': did you mean 'street'? allowed are" in message
    assert "a generated scene such as town[seed=7], or the path of a .toml file" in message


def test_scatterers_know_their_object_and_no_digest_depends_on_it():
    scenario = load_scenario("town[seed=7,visible=seen]")
    objects = scenario.scatterers.objects
    assert len(objects) == len(scenario.scatterers)
    assert {"vehicle 1", "vehicle 2"} <= set(objects)
    nameless = dataclasses.replace(scenario, scatterers=dataclasses.replace(scenario.scatterers, objects=()))
    assert scenario_digest(nameless) == scenario_digest(scenario)
    with pytest.raises(InputError, match="1 names; allowed are none or"):
        dataclasses.replace(scenario.scatterers, objects=("one",))
