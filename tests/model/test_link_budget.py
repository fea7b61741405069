"""Link budgets: path loss of TR 36.777 and TR 38.901, element patterns, and the SNR of an echo."""

import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from tr3gpp import tr36777

from isacbench import load_scenario, observe
from isacbench.model.array import VirtualArray
from isacbench.model.frame import PanelFrame, PaperFrame
from isacbench.model.link_budget import (
    LinkBudget,
    element_gain_dbi,
    free_space_loss_db,
    uma_av_loss_db,
    uma_av_sight,
)
from isacbench.model.numerology import SPEED_OF_LIGHT_MPS, System
from tests.conftest import refusal

BASE_M, CARRIER_HZ = np.array([0.0, 0.0, 25.0]), 4.9e9
SYSTEM = System(
    carrier_hz=CARRIER_HZ,
    subcarrier_spacing_hz=30e3,
    n_subcarriers=3276,
    n_symbols=14,
    cyclic_prefix_ratio=1 / 14,
)
SCENE = """
name = "budget"
path_loss = "{path_loss}"
[system]
carrier_hz = 4.9e9
subcarrier_spacing_hz = 30e3
n_subcarriers = 3276
n_symbols = 14
[array]
frame = "panel"
tx_shape = [1, 1]
tx_spacing = 1
rx_shape = [2, 2]
[base_station]
position_m = [0.0, 0.0, 25.0]
[region]
x_m = [-250.0, 250.0]
y_m = [-290.0, -10.0]
z_m = [0.0, 300.0]
speed_mps = [-50.0, 50.0]
[budget]
tx_power_dbm = 52.0
noise_figure_db = 5.0
{budget}
[[objects]]
kind = "point"
position_m = [10.0, -200.0, 120.0]
{strength}
"""
places = st.tuples(st.floats(-250, 250), st.floats(-290, -10), st.floats(0, 300))


@pytest.fixture
def load_budget(tmp_path):
    """Return a function that loads a point with a link budget from the temporary folder."""

    def build(path_loss="free_space", budget="", strength="rcs_dbsm = -10.0"):
        path = tmp_path / "budget.toml"
        path.write_text(SCENE.format(path_loss=path_loss, budget=budget, strength=strength))
        return load_scenario(path)

    return build


def sight(ground_m, height_m):
    """Line of sight as TR 36.777, Table B-1, and TR 38.901, Table 7.4.2-1, write it, for one place."""
    if height_m > 100:
        return 1.0
    if height_m > 22.5:
        d1, p1 = max(460 * math.log10(height_m) - 700, 18), 4300 * math.log10(height_m) - 3800
        return 1.0 if ground_m <= d1 else d1 / ground_m + math.exp(-ground_m / p1) * (1 - d1 / ground_m)
    if ground_m <= 18:
        return 1.0
    c = 0.0 if height_m <= 13 else ((height_m - 13) / 10) ** 1.5
    near = 18 / ground_m + math.exp(-ground_m / 63) * (1 - 18 / ground_m)
    return min(near * (1 + c * 5 / 4 * (ground_m / 100) ** 3 * math.exp(-ground_m / 150)), 1.0)


def losses(place):
    """Losses in dB in line of sight and out of it, for one place, without shadow fading."""
    x, y, height_m = place
    ground_m, range_m = math.hypot(x, y), math.dist(place, BASE_M)
    height_m, f = max(height_m, 1.5), CARRIER_HZ / 1e9
    pl1 = 28.0 + 22 * math.log10(range_m) + 20 * math.log10(f)
    if height_m > 22.5:
        return pl1, -17.5 + (46 - 7 * math.log10(height_m)) * math.log10(range_m) + 20 * math.log10(
            40 * math.pi * f / 3
        )
    breakpoint_m = 4 * 24 * (height_m - 1) * CARRIER_HZ / SPEED_OF_LIGHT_MPS
    if ground_m > breakpoint_m:
        pl1 = 28.0 + 40 * math.log10(range_m) + 20 * math.log10(f)
        pl1 -= 9 * math.log10(breakpoint_m**2 + (25 - height_m) ** 2)
    return pl1, max(pl1, 13.54 + 39.08 * math.log10(range_m) + 20 * math.log10(f) - 0.6 * (height_m - 1.5))


def loss_db(place, key):
    xyz = np.array([place])
    return float(uma_av_loss_db(xyz, np.linalg.norm(xyz - BASE_M, axis=1), BASE_M, CARRIER_HZ, key)[0])


@given(places)
def test_line_of_sight_is_that_of_the_standard(place):
    ground_m, height_m = math.hypot(*place[:2]), place[2]
    assert uma_av_sight(np.array([ground_m]), np.array([height_m]))[0] == pytest.approx(
        sight(ground_m, height_m)
    )


@pytest.mark.parametrize(
    "place", [(0, -150, 30), (50, -120, 60), (100, -250, 200), (0, -60, 1.5), (9, -200, 15)]
)
def test_losses_are_those_of_the_standard_with_shadow_fading_of_its_deviations(place):
    drawn = np.array([loss_db(place, f"draw {number}") for number in range(3000)])
    seen_db, hidden_db = losses(place)
    share = sight(math.hypot(*place[:2]), place[2])
    deviation_db = 4.64 * math.exp(-0.0066 * place[2]) if place[2] > 22.5 else 4.0
    mixture = share * stats.norm.cdf(np.sort(drawn), seen_db, deviation_db)
    mixture += (1 - share) * stats.norm.cdf(np.sort(drawn), hidden_db, 6.0)
    steps = np.arange(len(drawn) + 1) / len(drawn)
    distance = max((mixture - steps[:-1]).max(), (steps[1:] - mixture).max())
    assert distance < stats.kstwobign.isf(1e-4) / math.sqrt(len(drawn))


def evaluated(formula, **names):
    """Value of a formula that the standard's tables write in LaTeX."""
    text = formula.partition("=")[2].replace("\\left(", "(").replace("\\right)", ")")
    text = re.sub(r"\\dfrac\{(.*?)\}\{(.*?)\}", r"((\1)/(\2))", text)
    for latex, python in {
        "\\log_{10}": "*log10",
        "\\exp": "*exp",
        "\\pi": "*pi*",
        "d_{3D}": "d",
        "f_c": "f",
        "h_{UT}": "h",
    }.items():
        text = text.replace(latex, python)
    text = re.sub(
        r"([+(/-]|^) *\*", r"\1 ", text.replace(" h", "*h").replace(")(", ")*(").replace("* f", "*f")
    )
    known = {"log10": math.log10, "exp": math.exp, "pi": math.pi}
    return eval(text.replace(" ", ""), {"__builtins__": {}}, {**known, **names})


@pytest.mark.parametrize(("condition", "is_hidden"), [("LOS", 0), ("NLOS", 1)])
def test_losses_above_roofs_are_the_formulas_of_the_standards_tables(condition, is_hidden):
    annex, place = tr36777.annex("B"), (100.0, -150.0, 80.0)
    names = {"d": math.dist(place, BASE_M), "h": 80.0, "f": CARRIER_HZ / 1e9}
    formula = annex.pathloss(scenario="UMa-AV", condition=condition)[1].pathloss
    assert losses(place)[is_hidden] == pytest.approx(evaluated(formula, **names))
    fading = annex.shadow_fading_std(scenario="UMa-AV", condition=condition)[1].sf_std
    assert evaluated(fading, **names) == pytest.approx(6.0 if is_hidden else 4.64 * math.exp(-0.0066 * 80))


@given(places, st.tuples(*3 * [st.floats(-0.3, 0.3)]))
def test_the_points_of_an_object_share_sight_and_fading(place, apart):
    xyz = np.array([place, np.add(place, apart)])
    both = uma_av_loss_db(xyz, np.linalg.norm(xyz - BASE_M, axis=1), BASE_M, CARRIER_HZ, "one")
    expected = [losses(point) for point in xyz.tolist()]
    apart_db = [first - second for first, second in zip(*expected, strict=True)]
    if min(abs(point[2] - edge) for point in xyz for edge in (22.5, 1.5)) > 0.31:
        assert min(abs(np.diff(both)[0] + one) for one in apart_db) < 1e-9


@given(st.floats(-180, 180), st.floats(-60, 60), st.floats(-89, 89), st.floats(-89, 89))
def test_an_element_has_the_pattern_of_the_standard_about_its_panels_normal(yaw, tilt, azimuth, elevation):
    frame = PanelFrame(yaw_deg=yaw, tilt_deg=tilt)
    a, e = np.radians([azimuth, elevation])
    local = np.array([np.cos(e) * np.sin(a), -np.sin(e), np.cos(e) * np.cos(a)])
    loss = min(12 * (elevation / 65) ** 2, 30) + min(12 * (azimuth / 65) ** 2, 30)
    found = element_gain_dbi(frame, 70 * (local @ frame.axes)[None])[0]
    assert found == pytest.approx(8 - min(loss, 30), abs=1e-6)


@pytest.mark.parametrize("element", ["isotropic", "tr38901"])
def test_the_snr_of_an_echo_is_that_of_the_radar_equation(load_budget, element):
    scenario = load_budget(budget=f'element = "{element}"')
    noise_dbm = -174 + 10 * np.log10(30e3) + 5
    received_dbm = 52 - 10 * np.log10(3276) - 10 + 10 * np.log10(4 * np.pi / SYSTEM.wavelength_m**2)
    received_dbm -= 2 * free_space_loss_db(scenario.range_m, CARRIER_HZ)[0]
    if element == "tr38901":
        offset_m = scenario.scatterers.xyz - BASE_M
        received_dbm += 2 * element_gain_dbi(scenario.frame, offset_m)[0]
    # -174 dBm/Hz is kT at 290 K but for 0.03 dB.
    assert 10 * np.log10(scenario.truth.power[0]) == pytest.approx(received_dbm - noise_dbm, abs=0.03)


def test_noise_is_that_of_the_budget_and_the_snr_an_offset_from_it(load_budget):
    scenario, weak = load_budget(), load_budget(strength="rcs_dbsm = -90.0")
    for offset_db in (0.0, 12.0):
        noise = [observe(one, offset_db).cells - observe(one, np.inf).cells for one in (scenario, weak)]
        # The same noise, whatever echoes there are.
        np.testing.assert_allclose(noise[0], noise[1], atol=1e-9)
        assert np.mean(np.abs(noise[0]) ** 2) == pytest.approx(10 ** (-offset_db / 10), rel=0.1)


def test_residual_leakage_adds_to_the_thermal_noise():
    plain, both = LinkBudget(52.0, 5.0), LinkBudget(52.0, 5.0, residual_dbm=-94.0)
    added_dbm = 10 * np.log10((both.noise_w(SYSTEM) - plain.noise_w(SYSTEM)) * SYSTEM.n_subcarriers * 1e3)
    assert added_dbm == pytest.approx(-94.0)


def test_transmitters_that_send_at_once_share_the_power():
    one = LinkBudget(52.0).unit_amplitude(SYSTEM, VirtualArray((1, 1), (2, 2), 1, 1))
    four = LinkBudget(52.0).unit_amplitude(SYSTEM, VirtualArray((2, 2), (2, 2), 2, 1))
    in_turns = LinkBudget(52.0).unit_amplitude(SYSTEM, VirtualArray((2, 2), (2, 2), 2, 1, mimo="comb"))
    assert (one / four) ** 2 == pytest.approx(4)
    assert in_turns == one


@pytest.mark.parametrize(
    ("keys", "parts"),
    [
        ({"path_loss": "none"}, ("budget", "path_loss", "uma_av")),
        ({"strength": "amplitude = 2.0"}, ("objects[0]", "rcs_dbsm")),
        ({"budget": "residual_dbm = 301.0"}, ("budget.residual_dbm", "301", "-300 to 300")),
        ({"budget": 'element = "horn"'}, ("budget.element", "horn", "tr38901")),
    ],
)
def test_a_budget_that_does_not_follow_is_refused(load_budget, keys, parts):
    message = refusal(load_budget, **keys)
    assert all(part in message for part in parts)


def test_the_pattern_of_an_element_needs_a_panel():
    below_m = np.array([[1.0, -9.0, -3.0]])
    assert 'needs frame = "panel"' in refusal(
        LinkBudget(1.0, element="tr38901").two_way_gain, PaperFrame(), below_m
    )
