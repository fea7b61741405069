"""Scenes at the limits of the radio: whole axes, few elements, echoes that cancel, and any level."""

import dataclasses

import numpy as np
import pytest
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.music2d import Music2d

from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator
from isacbench.model.frame import PanelFrame
from isacbench.model.numerology import System
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers, Scenario
from isacbench.plugins.registry import get_estimator

NAMES = [
    *("fft4d", "fft4d-element", "music2d", "music2d-root", "music2d_joint", "esprit2d"),
    *("bartlett2d", "capon2d", "iaa2d", "nomp4d", "omp4d", "sbl4d"),
]
VARIANTS = {"fft4d-element": Fft4d(integration="element"), "music2d-root": Music2d(search="root")}
EVERY = [VARIANTS.get(name) or get_estimator(name) for name in NAMES]
CELLWISE = EVERY[:9]
REGION = Region((0.0, 20.0), (0.0, 20.0), (0.0, 6.0), (-30.0, 30.0))
BASE_M = np.array([10.0, 50.0, 12.0])
THREE = np.array([(4.0, 5.0, 1.0, 0.0), (13.0, 9.0, 3.0, 17.0), (17.0, 3.0, 5.0, -21.0)])


def by_turns(estimators, names, values):
    """Give every second estimator a value, and the others the next."""
    return pytest.mark.parametrize(
        ("estimator", names),
        [
            pytest.param(one, value, id=f"{value}-{name}")
            for i, (one, name) in enumerate(zip(estimators, NAMES, strict=False))
            for j, value in enumerate(values)
            if (i + j) % 2 == 0
        ],
    )


def scene(points, amplitude=1.0, phase_rad=0.0, shape=(6, 6), region=REGION, base_m=BASE_M, **system):
    """Scatterers at (x, y, z, v) in front of an array."""
    points = np.reshape(points, (-1, 4))
    amplitude, phase_rad = (np.broadcast_to(values, len(points)) for values in (amplitude, phase_rad))
    return Scenario(
        name="hostile",
        system=System(**{"n_subcarriers": 256, "n_symbols": 64, **system}),
        array=VirtualArray((1, 1), shape),
        frame=PanelFrame(),
        base_station_m=base_m,
        region=region,
        scatterers=Scatterers(points[:, :3], points[:, 3], amplitude, phase_rad),
    )


def image(estimator, scenario, snr_db=20.0):
    return estimator.estimate(Simulator(scenario).observe(snr_db))


def assert_lone_point_at(cloud, place, tolerance_m, tolerance_mps):
    assert len(cloud) == 1
    assert np.linalg.norm(cloud.xyz[0] - place[:3]) < tolerance_m
    assert abs(cloud.velocity[0] - place[3]) < tolerance_mps


@by_turns(CELLWISE, "end", [(64, -0.499), (64, 0.49), (13, -0.49), (13, -0.3)])
def test_a_scatterer_at_either_end_of_a_doppler_axis_without_margins_is_seen(estimator, end):
    n_symbols, place = end
    system = System(n_subcarriers=256, n_symbols=n_symbols)
    fastest = system.unambiguous_speed_mps
    region = dataclasses.replace(REGION, speed_mps=(-fastest, fastest))
    bin_mps = system.velocity_bin_mps
    speed_mps = place * n_symbols * bin_mps
    point = [13.0, 9.0, 3.0, speed_mps]
    cloud = image(estimator, scene(point, region=region, n_symbols=n_symbols))
    assert_lone_point_at(cloud, point, 0.2, 0.05 * bin_mps)


@by_turns(EVERY, "range_bin", [0.02, 0.4, 15.3, 15.49])
def test_a_scatterer_at_either_end_of_a_range_axis_without_margins_is_seen(estimator, range_bin):
    system = System(n_subcarriers=16, n_symbols=64)
    farthest_m = system.unambiguous_range_m
    base_m = np.array([0.0, 0.0, 12.0])
    region = Region((-60.0, 60.0), (-0.985 * farthest_m, -0.01), (0.0, 14.0), (-30.0, 30.0))
    direction = np.array([0.05, -np.sqrt(1 - 0.05**2 - 0.005**2), -0.005])
    point = [*(base_m + range_bin * system.range_bin_m * direction), 0.0]
    scenario = scene(
        point,
        region=region,
        base_m=base_m,
        n_subcarriers=16,
        cyclic_prefix_ratio=1.0,
        cyclic_suffix_ratio=0.0,
    )
    assert_lone_point_at(image(estimator, scenario), point, 0.02 * system.range_bin_m, 0.5)


@by_turns(CELLWISE, "shape", [(2, 2), (2, 3), (3, 5), (4, 4), (2, 32), (32, 2)])
def test_few_elements_show_resolved_scatterers_and_nothing_else(estimator, shape):
    cloud = image(estimator, scene(THREE, shape=shape))
    assert len(cloud) == 3
    distance_m = np.linalg.norm(cloud.xyz[:, None] - THREE[None, :, :3], axis=2)
    assert distance_m.min(axis=0).max() < 0.25


@pytest.mark.parametrize("estimator", EVERY, ids=NAMES)
@pytest.mark.parametrize(
    ("amplitude", "phase_rad", "snr_db"),
    [
        ([1.0, 1.0], [0.0, np.pi], np.inf),
        ([1.0, -1.0], 0.0, 200.0),
        ([1.0] * 4, np.arange(4) * np.pi / 2, np.inf),
    ],
)
def test_echoes_that_cancel_are_no_points(estimator, amplitude, phase_rad, snr_db):
    points = np.tile(THREE[1], (len(amplitude), 1))
    assert len(image(estimator, scene(points, amplitude, phase_rad), snr_db)) == 0


@pytest.mark.parametrize("estimator", CELLWISE, ids=NAMES[: len(CELLWISE)])
def test_cells_of_tiny_numbers_and_one_huge_element_are_imaged_without_a_warning(estimator):
    shot = Simulator(scene(THREE)).observe(10.0)
    tiny = np.full_like(shot.cells, 1e-300)
    lone_element, saturated_element = np.zeros_like(shot.cells), shot.cells.copy()
    lone_element[:, :, 3, 4] = saturated_element[:, :, 3, 4] = 1e60
    for cells in (tiny, lone_element, saturated_element):
        observation = dataclasses.replace(shot, cells=cells)
        cloud = estimator.estimate(observation)
        assert np.isfinite(cloud.to_array()).all()


@pytest.mark.parametrize("integration", ["noncoherent", "element"])
def test_exact_nulls_of_a_spectrum_are_drawn_without_a_warning(integration):
    # A scatterer straight ahead: the transform of equal numbers is zero at every multiple of 2/P.
    point = [10.0, 10.0, 12.0, 0.0]
    region = Region((0.0, 20.0), (0.0, 20.0), (0.0, 20.0), (-30.0, 30.0))
    observation = Simulator(scene(point, region=region)).observe(np.inf)
    diagnosis = Fft4d(integration=integration).diagnose(observation)
    assert len(diagnosis.spectra) == 2
    for spectrum in diagnosis.spectra:
        assert np.isfinite(spectrum.level_db).all()
        assert spectrum.level_db.max() == 0


@by_turns(EVERY, "u", [0.97, -0.97])
def test_an_echo_at_the_end_of_all_directions_is_one_point_where_it_is(estimator, u):
    # A station over the middle of its region: every cosine u is possible, and -1.03 looks like 0.97.
    base_m, region = (
        np.array([0.0, -0.5, 3.0]),
        Region((-40.0, 40.0), (-30.0, -1.0), (0.0, 3.0), (-10.0, 10.0)),
    )
    point = [*(base_m + 30.0 * np.array([u, -np.sqrt(1 - u**2 - 0.05**2), -0.05])), 0.0]
    cloud = image(estimator, scene(point, region=region, base_m=base_m, shape=(12, 12)))
    nearest = np.linalg.norm(cloud.xyz - point[:3], axis=1).min(initial=np.inf)
    assert len(cloud) == 1
    assert nearest < 0.5
