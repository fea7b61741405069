"""Cross sections of TR 38.901 and path loss: tables of the standard, draws, and what echoes add up to."""

import numpy as np
import pytest
from scipy import stats
from tr3gpp import tr38901

from isacbench.model.numerology import System
from isacbench.model.scenes.placed_objects import CROSS_SECTIONS, cross_section_dbsm
from tests.conftest import refusal

TABLES = {
    "tr38901:uav_small": "UAV with small size",
    "tr38901:human": "Human with RCS model 1",
    "tr38901:uav_large": "UAV with large size",
    "tr38901:vehicle": "Vehicle with single scattering point",
    "tr38901:agv": "AGV with single scattering point",
}
VEHICLE = '[[objects]]\nkind = "vehicle"\nposition_m = [20.0, 10.0, 0.0]\n'


def test_means_and_spreads_are_those_of_the_standard():
    standard = tr38901.section("7.9")
    assert TABLES.keys() == CROSS_SECTIONS.keys()
    for name, target in TABLES.items():
        if name in ("tr38901:uav_small", "tr38901:human"):
            entries = [standard.rcs_model_1(target=target)]
        else:
            points = ("Front", "Left", "Back", "Right", "Roof")
            entries = [standard.rcs_model_2(target=target, scattering_point=point) for point in points]
        for entry in entries:
            assert CROSS_SECTIONS[name] == (float(entry.lg_sigma_m_dbsm), float(entry.sigma_sigmaS_db))


@pytest.mark.parametrize("name", ["tr38901:human", "tr38901:uav_large"])
def test_draws_are_log_normal_with_the_standards_mean_in_square_metres(name):
    mean_dbsm, deviation_db = CROSS_SECTIONS[name]
    drawn = np.array([cross_section_dbsm(name, f"draw {number}") for number in range(4000)])
    assert stats.kstest((drawn - drawn.mean()) / deviation_db, "norm").pvalue > 1e-3
    assert drawn.std() == pytest.approx(deviation_db, rel=0.05)
    # Eq. 7.9.2-1: the mean in dB is lower than that in square metres.
    assert 10 * np.log10((10 ** (drawn / 10)).mean()) == pytest.approx(mean_dbsm, abs=0.35)
    assert drawn.mean() == pytest.approx(mean_dbsm - np.log(10) / 20 * deviation_db**2, abs=0.25)


@pytest.mark.parametrize("visible", ["all", "seen"])
@pytest.mark.parametrize("rcs", ["10.0", "-3", '"tr38901:human"'])
def test_the_points_of_an_object_share_its_cross_section_evenly(load_objects, rcs, visible):
    amplitude = load_objects(f"{VEHICLE}rcs_dbsm = {rcs}\n", f'visible = "{visible}"').scatterers.amplitude
    given = cross_section_dbsm(rcs.strip('"'), "rcs 0 0") if '"' in rcs else float(rcs)
    assert (amplitude == amplitude[0]).all()
    assert (amplitude**2).sum() == pytest.approx(10 ** (given / 10))


def test_draws_differ_between_objects_and_seeds_and_not_between_loads(load_objects):
    objects = 2 * f'{VEHICLE}rcs_dbsm = "tr38901:vehicle"\n'
    drawn = [load_objects(objects, f"rcs_seed = {seed}").scatterers.amplitude for seed in (0, 0, 1)]
    np.testing.assert_array_equal(drawn[0], drawn[1])
    assert len({*drawn[0].tolist(), *drawn[2].tolist()}) == 4


def test_an_object_keeps_its_draw_when_others_hide_part_of_it(load_objects):
    wall = '[[objects]]\nkind = "box"\nposition_m = [19.0, 16.0, 0.0]\nsize_m = [2.0, 1.0, 3.0]\n'
    objects = f'{VEHICLE}rcs_dbsm = "tr38901:vehicle"\n'
    totals = []
    for scene in (objects, objects + wall):
        scatterers = load_objects(scene, 'visible = "seen"').scatterers
        of_vehicle = scatterers.xyz[:, 1] < 13
        totals.append(((scatterers.amplitude[of_vehicle] ** 2).sum(), of_vehicle.sum()))
    assert totals[0][0] == pytest.approx(totals[1][0])
    assert totals[0][1] > totals[1][1]


def test_path_loss_is_the_radar_equation(load_objects):
    point = '[[objects]]\nkind = "point"\nposition_m = [20.0, {}, 5.0]\n'
    scenario = load_objects("".join(map(point.format, (0.0, 15.0, 30.0))), 'path_loss = "free_space"')
    expected = System().wavelength_m ** 2 / ((4 * np.pi) ** 3 * scenario.range_m**4)
    np.testing.assert_allclose(scenario.truth.power, expected, rtol=1e-12)


def test_path_loss_comes_on_top_of_amplitude_and_cross_section(load_objects):
    for strength in ("amplitude = 3.0", "rcs_dbsm = 20.0"):
        objects = f"{VEHICLE}{strength}\n"
        with_loss, without = (load_objects(objects, keys) for keys in ('path_loss = "free_space"', ""))
        ratio = with_loss.scatterers.amplitude / without.scatterers.amplitude * without.range_m**2
        np.testing.assert_allclose(ratio, ratio[0])


NEEDS_PHASES = (
    "objects[0]: rcs_dbsm needs carrier phases, because its scatterers would add up in phase; "
    "allowed is coherent_phase = true in [system]"
)
NUMBER = "allowed is a number of dBsm from -200 to 200, or one of "
MISTAKES = {
    "rcs_dbsm = 10.0\namplitude = 1.0": "allowed is amplitude or rcs_dbsm, not both",
    'rcs_dbsm = "tr38901:lorry"': f"[0].rcs_dbsm = 'tr38901:lorry': {NUMBER}\"tr38901:uav_small\"",
    "rcs_dbsm = nan": f"objects[0].rcs_dbsm = nan: {NUMBER}",
    "rcs_dbsm = [1]": NUMBER,
    "rcs_dbsm = true": NUMBER,
}


def test_a_mistake_is_told_in_one_line(load_objects):
    for line, message in MISTAKES.items():
        assert message in refusal(load_objects, f"{VEHICLE}{line}\n")
    for key in ("rcs_seed = -1", "path_loss = 'umi'", "visible = 'some'"):
        assert key in refusal(load_objects, VEHICLE, key)
    assert NEEDS_PHASES in refusal(load_objects, f"{VEHICLE}rcs_dbsm = 10.0\n", coherent="false")
