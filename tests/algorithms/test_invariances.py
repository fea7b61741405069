"""Images do not depend on units, precision, memory, threads, last bits, or the scatterers' order and side."""

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.music2d import Music2d
from isacbench_algorithms.references import Oracle
from threadpoolctl import threadpool_limits

from isacbench.checking.cases import spread
from isacbench.checking.image_checks import ELEMENT_ORDER, ImageSubject, cloud_difference
from isacbench.checking.scenes import RESOLVED, Echo, Layout, observed, scenario_of
from isacbench.errors import InputError
from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator
from isacbench.model.radio_coordinates import rayleigh_cells, space_places
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers
from isacbench.plugins.registry import estimator_names, get_estimator, sees_truth
from tests.algorithms.scenes import EMPTY
from tests.conftest import few, slow_but

BLIND = {name: get_estimator(name) for name in estimator_names() if not sees_truth(name)}
CROSSES = {f"{one.name}-element": one(integration="element") for one in (Fft4d, Music2d)}
EVERY = {**BLIND, **CROSSES, "music2d-root": Music2d(search="root")}
FAR, NEAR = 498, -40
"""Binary exponents: of cells whose powers are still numbers, and of those that no estimator scales itself."""


def crowd():
    """Twelve echoes within three range and two Doppler bins."""
    rng = np.random.default_rng(3)
    places = rng.uniform([8, -1, -0.5, -0.5], [11, 1, 0.5, 0.5], (12, 4))
    levels = rng.uniform([0.5, 0], [1.5, 2 * np.pi], (12, 2))
    return [Echo(*row) for row in np.column_stack([places, levels]).tolist()]


def nudged(cells, seed=0):
    """Cells with other last bits."""
    noise = np.random.default_rng(seed).standard_normal((*cells.shape, 2)).view(complex)[..., 0]
    return cells * (1 + 1e-15 * noise)


def assert_scaled_by_a_power_of_two(image, exponent):
    """Places are the same in every bit, and powers are those of the other unit."""
    cloud, scaled = image.cloud, image.image_of(image.scene.observation.cells * 2.0**exponent)
    np.testing.assert_array_equal(scaled.to_array()[:, :4], cloud.to_array()[:, :4], f"2^{exponent}")
    np.testing.assert_array_equal(scaled.power, cloud.power * 2.0**exponent * 2.0**exponent)


def assert_same_in_any_memory(image, factor, bound, single_bound):
    """With other last bits, memory order and unit, and with two threads, the difference is below a bound.

    In single precision, with gaps between the elements, it is below another.
    """
    cells = image.scene.observation.cells
    single = np.repeat(cells.astype(np.complex64), 2, axis=2)[:, :, ::2]
    assert image.difference(image.image_of(single)) < single_bound
    with threadpool_limits(limits=2):
        scaled = image.image_of(np.asfortranarray(nudged(cells)) * factor)
    assert image.difference(replace(scaled, power=scaled.power / factor / factor)) < bound


@cache
def scene_apart():
    """Three echoes, each in cells of its own."""
    region = Region((-5.0, 30.0), (20.0, 46.0), (-5.0, 35.0), (-50.0, 50.0))
    return observed(RESOLVED, 10.0, layout=Layout(array=(6, 5), region=region))


@cache
def apart(name):
    return ImageSubject(EVERY[name], scene_apart())


@pytest.mark.parametrize("name", EVERY)
def test_an_image_of_echoes_apart_is_the_same_in_any_unit_memory_precision_and_number_of_threads(name):
    image = apart(name)
    assert len(image.cloud) == len(RESOLVED)
    for exponent in (-FAR, NEAR):
        assert_scaled_by_a_power_of_two(image, exponent)
    assert_same_in_any_memory(image, 1e150, 1e-10, 1e-6)


@pytest.mark.parametrize("name", ["fft4d", "music2d", "music2d_joint", "esprit2d"])
def test_so_is_the_image_of_a_crowd(name):
    image = ImageSubject(get_estimator(name), observed(crowd(), 30.0, layout=Layout(array=(8, 6))))
    assert len(image.cloud) > len(RESOLVED)
    assert_scaled_by_a_power_of_two(image, FAR)
    # The last step of the joint fit of a crowd is one that rounding takes or leaves.
    assert_same_in_any_memory(image, 0.3, 1e-7, 1e-5)


@few
@given(
    name=st.sampled_from(["nomp4d", "fft4d", "music2d"]),
    n_echoes=st.integers(1, 8),
    draw=st.integers(0, 9999),
    snr_db=st.sampled_from([-10.0, 0.0, 30.0, np.inf]),
    exponent=st.integers(-FAR, FAR),
)
@example(name="nomp4d", n_echoes=3, draw=1, snr_db=10.0, exponent=NEAR)
def test_so_is_the_image_of_any_echoes_apart(name, n_echoes, draw, snr_db, exponent):
    image, _ = spread.case(n_echoes=n_echoes, draw=draw).make(get_estimator(name))
    noisy = replace(image.scene, observation=Simulator(image.scene.scenario).observe(snr_db))
    image = replace(image, scene=noisy)
    assert_scaled_by_a_power_of_two(image, exponent)
    assert image.difference(image.image_of(nudged(noisy.observation.cells))) < 1e-9


@pytest.mark.parametrize("name", BLIND)
def test_a_mirrored_array_sees_the_mirrored_scene(name):
    assert ELEMENT_ORDER.measure(apart(name)) < 1e-9


@pytest.mark.parametrize(
    ("name", "echoes"),
    [
        *(("fft4d", RESOLVED), ("nomp4d", RESOLVED), ("oracle", crowd())),
        *((name, crowd()) for name in ("music2d", "music2d_joint", "esprit2d")),
    ],
    ids=lambda value: value if isinstance(value, str) else f"{len(value)} echoes",
)
def test_the_order_of_scatterers_moves_no_point(name, echoes):
    estimator, clouds = get_estimator(name), []
    for order in (echoes, echoes[5:] + echoes[2:5] + echoes[:2]):
        scenario = scenario_of(order)
        truth = (scenario.truth,) if isinstance(estimator, Oracle) else ()
        clouds.append(estimator.estimate(Simulator(scenario).observe(20.0), *truth))
    assert len(clouds[0]) >= 3
    assert cloud_difference(scenario, *clouds) < 1e-7


@pytest.mark.parametrize("estimator", EVERY.values(), ids=EVERY)
def test_cells_whose_power_is_no_number_are_refused(estimator):
    seen = scene_apart().observation
    message = r"observation: its largest amplitude = .*: allowed is less than 3\.3"
    with pytest.raises(InputError, match=message):
        estimator.estimate(replace(seen, cells=seen.cells * 1e200))


@pytest.mark.parametrize("name", ["fft4d", "music2d", "nomp4d"])
@pytest.mark.parametrize(
    "offsets",
    [
        [[0, 0.5, 0.5, 0.25]],
        [[k, 0.5, 0, 0] for k in (-1, 1)],
        [[0, 0.5, *k] for k in product((-1, 1), repeat=2)],
    ],
)
def test_halfway_between_two_cells_rounding_decides_nothing(name, offsets):
    estimator = get_estimator(name)
    middle = np.array([37 * EMPTY.system.range_bin_m, EMPTY.system.velocity_bin_mps, 0, 0])
    xyz, velocity = space_places(EMPTY, middle + np.array(offsets) * rayleigh_cells(EMPTY))
    seen = Simulator(replace(EMPTY, scatterers=Scatterers(xyz, velocity, np.ones(len(xyz))))).observe(np.inf)
    cloud = estimator.estimate(seen)
    for seed in range(2):
        other = estimator.estimate(replace(seen, cells=nudged(seen.cells, seed)))
        assert cloud_difference(EMPTY, cloud, other) < 1e-9


@pytest.mark.parametrize("shape", slow_but(["8x8"], ["4x4", "4x8", "5x7", "8x4", "8x8", "16x16"]))
@pytest.mark.parametrize("axis", ["azimuth", "elevation"])
@pytest.mark.parametrize("name", [*BLIND, "music2d-root"])
def test_one_echo_is_one_point_up_to_89_degrees_on_either_side(name, axis, shape):
    estimator, range_m = EVERY[name], 40.0
    for angle_deg, side in ((79.0, -1), (85.0, 1), (89.0, -1), (89.0, 1)):
        angle = np.radians(angle_deg)
        aside, ahead = side * range_m * np.sin(angle), range_m * np.cos(angle)
        offset = (aside, -ahead, 0.0) if axis == "azimuth" else (0.0, -ahead, aside)
        place = EMPTY.base_station_m + offset
        echo = Scatterers(place[None], np.array([7.3]), np.ones(1))
        array = VirtualArray((1, 1), tuple(map(int, shape.split("x"))), 1, 1)
        region = replace(EMPTY.region, y_m=(60.0, 110.0), z_m=(-25.0, 75.0))
        seen = Simulator(replace(EMPTY, scatterers=echo, array=array, region=region)).observe(20.0)
        found = estimator.estimate(seen).xyz
        assert np.linalg.norm(found - place, axis=1) == pytest.approx([0.0], abs=1.0), (angle_deg, side)


@pytest.mark.parametrize("shape", [(8, 4), (4, 8), (2, 14), (16, 2), (6, 6)])
def test_fft4d_images_a_lone_echo_between_samples_on_few_elements(shape):
    rng = np.random.default_rng(3)
    for u in rng.uniform(-0.98, 0.98, 12):
        echo = Echo(9.3, 1.2, u, rng.uniform(-0.9, 0.9) * np.sqrt(1 - u * u))
        for snr_db in (np.inf, 20.0):
            assert (
                len(Fft4d().estimate(observed([echo], snr_db, layout=Layout(array=shape)).observation)) == 1
            )
