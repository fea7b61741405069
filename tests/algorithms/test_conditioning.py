"""Subspace methods at the end of their digits: no noise, far apart in power, close together."""

import numpy as np
import pytest
from isacbench_algorithms.chain import CellSnapshots, Levels
from isacbench_algorithms.esprit2d import Esprit2d
from isacbench_algorithms.music2d import Music2d
from isacbench_algorithms.music2d_joint import Music2dJoint

from isacbench.checking.cases import close, coherent
from isacbench.checking.image_checks import ANY_SCALE, ELEMENT_ORDER
from isacbench.instrument.remarks import Remarks
from isacbench.model.array import VirtualArray
from isacbench.model.echo import observe_echo
from isacbench.model.frame import PanelFrame
from isacbench.model.numerology import System
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers, Scenario
from tests.algorithms.scenes import distances_m

SYSTEM = System(n_subcarriers=512, n_symbols=64)
BASE_M = np.array([10.0, 50.0, 12.0])
REGION = Region((0.0, 20.0), (0.0, 20.0), (0.0, 6.0), (-30.0, 30.0))
RAYLEIGH = 2 / 10
ALL = pytest.mark.parametrize("method", [Music2d, Music2dJoint, Esprit2d])


def on_a_bin(x, y, z, doppler_bin=0):
    """Scatterer near a place, in the middle of a range-Doppler cell, so that nothing of it leaks."""
    offset = np.array([x, y, z]) - BASE_M
    n_bins = round(np.linalg.norm(offset) / SYSTEM.range_bin_m)
    place = BASE_M + offset / np.linalg.norm(offset) * n_bins * SYSTEM.range_bin_m
    return [*place, doppler_bin * SYSTEM.velocity_bin_mps]


FIRST = on_a_bin(10, 10, 3)


def beside(point, angle):
    """Scatterer of the same range, speed and height, an angle in rad further along the street."""
    x, y, z = np.array(point[:3]) - BASE_M
    cosine, sine = np.cos(angle), np.sin(angle)
    return [*(BASE_M + np.array([cosine * x - sine * y, sine * x + cosine * y, z])), point[3]]


def observe(points, shape=(10, 10), amplitude=None, phase=0.0, snr_db=np.inf):
    points = np.asarray(points, dtype=float).reshape(-1, 4)
    amplitude = np.ones(len(points)) if amplitude is None else amplitude
    scatterers = Scatterers(points[:, :3], points[:, 3], amplitude, phase)
    array = VirtualArray((1, 1), shape, 1, 1)
    scenario = Scenario("conditioning", SYSTEM, array, PanelFrame(), BASE_M, REGION, scatterers)
    return observe_echo(scenario, snr_db)


def farthest(cloud, points):
    """Largest distance in m of a point from the nearest of the others, either way."""
    distance = np.linalg.norm(cloud.xyz[:, None] - np.asarray(points)[:, :3], axis=2)
    return max(distance.min(axis=0).max(), distance.min(axis=1).max())


@ALL
@pytest.mark.parametrize("db", [60, 100])
def test_two_scatterers_of_one_cell_far_apart_in_power_are_both_imaged(method, db):
    points = [FIRST, beside(FIRST, 0.2)]
    observation = observe(points, amplitude=[1, 10 ** (-db / 20)])
    limits = {"dynamic_range_db": 160.0, "local_dynamic_range_db": 160.0}
    # What the last digits of the strong wave's direction leave unexplained is as strong as the weak one.
    cloud = method(**limits, largest_direction_error=None).estimate(observation)
    assert len(cloud) == 2
    assert farthest(cloud, points) < 1e-3


@ALL
@pytest.mark.parametrize("cells", [1e-4, 1e-6])
def test_scatterers_closer_than_any_duplicate_are_one_point_between_them(method, cells):
    points = [FIRST, beside(FIRST, cells * RAYLEIGH)]
    for phase in (0, 1):
        cloud = method().estimate(observe(points, phase=[0, phase]))
        assert len(cloud) == 1
        assert farthest(cloud, points) < 1e-2


@ALL
def test_an_element_that_answers_alone_has_no_direction_and_says_so(method):
    # Two equal eigenvalues, between which an order of one cuts.
    snapshots = np.zeros((1, 1, 8, 8), dtype=np.complex128)
    snapshots[0, 0, 0, 0] = 1
    levels = Levels(1e-30, 1e-3, 1e-12)
    one = method(max_order=1, subarray_fraction=1.0) if method is Music2d else method(max_sources=1)
    with Remarks() as remarks:
        cells = CellSnapshots(one.snapshot_rules()[-1], None, None, snapshots, levels)
        waves = one.plane_waves(observe([FIRST], (8, 8)), cells)
    assert not waves.found.any()
    assert remarks.counts["unseparated"].n == remarks.counts["unseparated"].of > 0


@ALL
def test_a_diagnosis_says_whether_its_subspaces_are_separated(method):
    assert method().diagnose(observe([FIRST], (8, 8), snr_db=20.0)).separated is True
    assert method().diagnose(observe(np.empty((0, 4)), (8, 8))).separated is None


@pytest.mark.parametrize(
    ("method", "case"),
    [
        (Music2dJoint, close.case(exponent=-1.0, along="all")),
        (Esprit2d, close.case(exponent=-1.25, along="u")),
        *((method, coherent.case(n_echoes=3, separation=0.3)) for method in (Music2dJoint, Esprit2d)),
        (Music2dJoint, coherent.case(n_echoes=3, separation=0.1)),
        (Esprit2d, coherent.case(n_echoes=4, separation=0.15)),
    ],
    ids=lambda value: getattr(value, "spec", None),
)
def test_echoes_in_phase_a_tenth_of_a_cell_apart_are_told_apart_to_the_last_digits_and_fewer_as_certain(
    method, case
):
    image, _ = case.make(method())
    truth = image.scene.scenario.truth
    if case.family is close or case.values[1] == 0.3:
        assert len(image.cloud) == len(truth)
        assert distances_m(image.cloud, truth).min(axis=0).max() < 1e-9
    else:
        assert 1 <= len(image.cloud) < len(truth)
    # The condition of the joint fit squared: 1e-8. Where fewer points leave 1e-5 of the map, steps that
    # lose no more than rounding are taken.
    assert ANY_SCALE.measure(image) < 1e-10
    assert ELEMENT_ORDER.measure(image) < 1e-10
