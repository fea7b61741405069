"""The echo: closed form against the full resource grid, and noise that is white and repeatable."""

import cmath
import dataclasses
import itertools
import math
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom, chi2

from isacbench.dsp.rangedoppler import range_doppler_map
from isacbench.errors import InputError, InputWarning
from isacbench.model import echo
from isacbench.model.array import VirtualArray
from isacbench.model.echo import (
    Simulator,
    central_phase,
    clean_echo,
    observe_echo,
    random_stream,
    resource_grid,
    unit_noise,
)
from isacbench.model.scene import Scatterers
from isacbench.model.scenes.scenario import load_scenario
from tests.conftest import few
from tests.gated_cells import cells_in_gate, gate_of

C = 299_792_458.0
SIGMAS = 5.0
PLACES, SPEEDS = st.tuples(st.floats(0, 10), st.floats(0, 10), st.floats(0, 5)), st.floats(-15, 15)


EACH_PHASE = pytest.mark.parametrize("coherent_phase", [False, True])
EACH_FRAME = pytest.mark.parametrize("frame", ["paper", "panel"])


def assert_closed_form_is_the_transformed_grid(scenario, elements, largest_error=None):
    """Hold the cells of the gate to those of the full resource grid of some elements."""
    gate = gate_of(scenario)
    expected = cells_in_gate(resource_grid(scenario, elements), gate)
    p, q = np.transpose(elements)
    error = np.abs(clean_echo(scenario, gate)[:, :, p, q] - expected).max()
    assert error <= (largest_error or 1e-10 * np.abs(expected).max())


def one_by_one(scenario):
    """Scenarios of one scatterer each."""
    for columns in zip(*dataclasses.astuple(scenario.scatterers)[:4], strict=True):
        alone = Scatterers(*(np.asarray(column)[None] for column in columns))
        yield dataclasses.replace(scenario, scatterers=alone)


@EACH_FRAME
@EACH_PHASE
def test_the_resource_grid_is_the_sum_over_scatterers_of_the_design(make_scenario, frame, coherent_phase):
    scenario = make_scenario(frame, n_subcarriers=5, n_symbols=3, coherent_phase=coherent_phase)
    elements = [(0, 0), (3, 1), (2, 2)]
    system, echoes = scenario.system, scenario.scatterers
    symbol_s = 1.25 / system.subcarrier_spacing_hz
    expected = np.zeros((5, 3, 3), dtype=complex)
    for xyz, v, a in zip(echoes.xyz, echoes.velocity, echoes.amplitude, strict=True):
        x, y, z = xyz - scenario.base_station_m
        r = math.sqrt(x * x + y * y + z * z)
        if frame == "panel":
            u, w = x / r, -z / r
        else:
            theta, cos_phi = math.atan2(-y, x), -z / r
            u, w = math.cos(theta) * cos_phi, math.sin(theta) * cos_phi
        gain = a * cmath.exp(-4j * math.pi * system.carrier_hz * r / C) if coherent_phase else a
        for n in range(5):
            for m in range(3):
                for e, (p, q) in enumerate(elements):
                    delay = cmath.exp(-2j * math.pi * n * system.subcarrier_spacing_hz * 2 * r / C)
                    doppler = cmath.exp(2j * math.pi * m * symbol_s * 2 * v * system.carrier_hz / C)
                    direction = cmath.exp(-1j * math.pi * (p * u + q * w))
                    expected[n, m, e] += gain * delay * doppler * direction
    np.testing.assert_allclose(resource_grid(scenario, elements), expected, atol=1e-9)


@EACH_FRAME
@EACH_PHASE
def test_the_closed_form_is_the_transformed_grid_whatever_the_size(make_scenario, frame, coherent_phase):
    for n_subcarriers, n_symbols in ((256, 32), (251, 13), (33, 1), (1, 7)):
        size = {"n_subcarriers": n_subcarriers, "n_symbols": n_symbols}
        scenario = make_scenario(frame, coherent_phase=coherent_phase, **size)
        assert_closed_form_is_the_transformed_grid(scenario, [(0, 0), (3, 1), (1, 3)])


@given(place=PLACES, speed_mps=SPEEDS, n_symbols=st.integers(1, 40))
def test_the_closed_form_is_the_transformed_grid_for_any_scatterer(
    make_scenario, place, speed_mps, n_symbols
):
    scenario = make_scenario(xyz=[place], velocity=[speed_mps], amplitude=[1.0], n_symbols=n_symbols)
    assert_closed_form_is_the_transformed_grid(scenario, [(0, 0), (3, 3)])


@pytest.mark.parametrize("name", ["street-coherent", "street-paper"])
def test_the_closed_form_is_the_transformed_grid_on_the_street(name):
    assert_closed_form_is_the_transformed_grid(load_scenario(name), [(0, 0), (15, 9)])


@EACH_PHASE
def test_the_phase_of_a_scatterer_turns_its_own_echo_and_no_other(make_scenario, coherent_phase):
    phase_rad = [0.0, 1.2, -2.5]
    turned = make_scenario(coherent_phase=coherent_phase, phase_rad=phase_rad)
    gate = gate_of(turned)
    parts = [clean_echo(alone, gate) for alone in one_by_one(make_scenario(coherent_phase=coherent_phase))]
    expected = sum(part * cmath.exp(1j * phase) for part, phase in zip(parts, phase_rad, strict=True))
    np.testing.assert_allclose(clean_echo(turned, gate), expected, atol=1e-9 * np.abs(expected).max())
    assert_closed_form_is_the_transformed_grid(turned, [(0, 0), (3, 2)])


@EACH_FRAME
@EACH_PHASE
def test_the_central_phase_is_that_of_the_middle_of_grid_and_array(make_scenario, frame, coherent_phase):
    system = {"n_subcarriers": 255, "n_symbols": 31, "coherent_phase": coherent_phase}
    array = VirtualArray((1, 1), (5, 3), 1, 1)
    scenario = make_scenario(frame, phase_rad=[0.3, -2.0, 3.0], array=array, **system)
    found = scenario.scatterers.amplitude * np.exp(1j * central_phase(scenario))
    middles = [resource_grid(alone, [(2, 1)])[127, 15, 0] for alone in one_by_one(scenario)]
    np.testing.assert_allclose(found, middles, atol=1e-7)


def test_an_approaching_scatterer_turns_as_the_shrinking_path_says(make_scenario):
    def grid_of(xyz, speed_mps):
        scenario = make_scenario(xyz=xyz, velocity=[speed_mps], amplitude=[1.0], coherent_phase=True)
        return resource_grid(scenario, [(0, 0)])

    scenario, xyz, speed_mps = make_scenario(), np.array([[5.0, 5.0, 2.0]]), 9.0
    offset_m = xyz - scenario.base_station_m
    nearer = xyz - offset_m / np.linalg.norm(offset_m) * speed_mps * scenario.system.symbol_time_s
    # The first subcarrier lies on the carrier, where the convention is exact.
    assert grid_of(xyz, speed_mps)[0, 1, 0] == pytest.approx(grid_of(nearer, 0.0)[0, 0, 0])


def alone_at(make_scenario, xyz, speed_mps, amplitude=(1.0,), **others):
    """Scenario of scatterers wherever they are."""
    n = len(amplitude)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        return make_scenario(xyz=[xyz] * n, velocity=[speed_mps] * n, amplitude=amplitude, **others)


@given(place=PLACES, speed_mps=SPEEDS, turns=st.integers(1, 1600), speed_turns=st.integers(-9, 9))
def test_echoes_from_beyond_what_is_unambiguous_are_those_of_the_place_that_they_fold_to(
    make_scenario, place, speed_mps, turns, speed_turns
):
    near = alone_at(make_scenario, place, speed_mps)
    system, base_m = near.system, near.base_station_m
    range_m = np.linalg.norm(place - base_m)
    far = base_m + (place - base_m) * (range_m + turns * system.unambiguous_range_m) / range_m
    fast_mps = speed_mps + 2 * speed_turns * system.unambiguous_speed_mps
    folded = alone_at(make_scenario, far, fast_mps, coherent_phase=False)
    expected = clean_echo(dataclasses.replace(near, system=folded.system), gate_of(near))
    # A place a million metres away is held to 1e-10 m, of a bin of 2.4 m.
    error = np.abs(clean_echo(folded, gate_of(near)) - expected).max()
    assert error <= 1e-8 * np.sqrt(system.processing_gain)


@pytest.mark.parametrize(
    "place", [(4.0, -1e6, 1.0), (-3e5, -1e6, -1e5), (5.0, 39.999, 10.0), (5.0, 40.0, 0.0)]
)
@pytest.mark.parametrize("speed_mps", [0.0, 1e3, -1e6, 2.9e8])
@pytest.mark.parametrize(("n_subcarriers", "n_symbols"), [(256, 32), (251, 13), (1, 1)])
def test_the_closed_form_is_the_transformed_grid_however_far_and_fast(
    make_scenario, place, speed_mps, n_subcarriers, n_symbols
):
    scenario = alone_at(make_scenario, place, speed_mps, n_subcarriers=n_subcarriers, n_symbols=n_symbols)
    bound = 1e-12 * np.sqrt(scenario.system.processing_gain)
    assert_closed_form_is_the_transformed_grid(scenario, [(0, 0), (3, 1)], bound)


@pytest.mark.parametrize(
    ("amplitude", "phase_rad"),
    [
        ([1.0, 1.0], [0.0, np.pi]),
        ([1.0, -1.0], [0.0, 0.0]),
        ([1e150, 1e150], [1.0, 1.0 + np.pi]),
        ([1e-150] * 4, [0.0, np.pi / 2, np.pi, -np.pi / 2]),
        (np.ones(600), np.arange(600) * 2 * np.pi / 600),
    ],
)
@EACH_PHASE
def test_echoes_that_cancel_leave_no_dust(make_scenario, amplitude, phase_rad, coherent_phase):
    others = {"phase_rad": phase_rad, "coherent_phase": coherent_phase}
    scenario = alone_at(make_scenario, [1.3, 2.2, 0.4], 3.7, amplitude, **others)
    assert not np.any(clean_echo(scenario, gate_of(scenario)))
    assert not np.any(resource_grid(scenario, [(0, 0), (1, 2)]))


def test_two_opposite_echoes_a_hair_apart_and_a_weak_one_beside_a_strong_one_are_no_dust(make_scenario):
    pair = {"xyz": [[1.3, 2.2, 0.4], [1.3, 2.2 + 1e-9, 0.4]], "velocity": [0, 0], "amplitude": [1, 1]}
    scenario = make_scenario(**pair, phase_rad=[0, np.pi], coherent_phase=True)
    apart_rad = 4 * np.pi / scenario.system.wavelength_m * 1e-9 * np.cos(0.3)
    found = np.abs(clean_echo(scenario, gate_of(scenario))).max()
    assert found > 0.1 * apart_rad * np.sqrt(scenario.system.processing_gain)
    both = make_scenario(amplitude=[1.0, 1e-7, 1.0])
    without = clean_echo(make_scenario(amplitude=[1.0, 0.0, 1.0]), gate_of(both))
    difference = np.abs(clean_echo(both, gate_of(both)) - without).max()
    assert difference > 0.3e-7 * np.sqrt(both.system.processing_gain)


@pytest.mark.parametrize("velocity", [np.linspace(-15, 15, 40), np.repeat([-9.0, 4.0], 20)])
def test_a_scene_too_large_for_memory_is_summed_in_parts(make_scenario, monkeypatch, velocity):
    rng = np.random.default_rng(4)
    scenario = make_scenario(xyz=rng.uniform(0, 5, (40, 3)), velocity=velocity, amplitude=np.ones(40))
    expected = clean_echo(scenario, gate_of(scenario)), resource_grid(scenario, [(0, 0), (1, 2)])
    monkeypatch.setattr(echo, "MOST_PRODUCTS", 5000)
    parts = clean_echo(scenario, gate_of(scenario)), resource_grid(scenario, [(0, 0), (1, 2)])
    for part, whole in zip(parts, expected, strict=True):
        np.testing.assert_allclose(part, whole, rtol=0, atol=1e-12 * np.abs(whole).max())


@few
@given(order=st.permutations(range(12)))
def test_the_order_of_scatterers_does_not_matter(make_scenario, order):
    rng = np.random.default_rng(8)
    xyz, velocity, amplitude = rng.uniform(0, 5, (12, 3)), rng.uniform(-15, 15, 12), rng.uniform(0, 2, 12)
    expected, found = (
        observe_echo(make_scenario(xyz=xyz[i], velocity=velocity[i], amplitude=amplitude[i]), 10.0).cells
        for i in (slice(None), order)
    )
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * np.abs(expected).max())


@given(exponent=st.integers(-480, 480), snr_db=st.sampled_from([-20.0, 10.0, 200.0, math.inf]))
def test_an_observation_scales_exactly_with_powers_of_two(make_scenario, exponent, snr_db):
    scale, amplitude = 2.0**exponent, np.array([1.0, 0.7, 0.3])
    scenes = (make_scenario(amplitude=factor * amplitude, n_subcarriers=64) for factor in (1.0, scale))
    plain, scaled = (observe_echo(scene, snr_db).cells for scene in scenes)
    np.testing.assert_array_equal(scaled, plain * scale)


@pytest.mark.parametrize(
    ("amplitude", "snr_db"), [(1.0, math.nan), (1.0, -math.inf), (1.0, -4000.0), (1e150, -80.0)]
)
def test_noise_that_is_no_number_or_too_strong_is_refused(make_scenario, amplitude, snr_db):
    scenario = make_scenario(amplitude=[amplitude] * 3)
    with pytest.raises(InputError, match=r"snr_db = .*: allowed is -\d+ and more, infinity for no noise"):
        observe_echo(scenario, snr_db)


@pytest.mark.parametrize("snr_db", [-80.0, 200.0, 3000.0, 1e300])
def test_noise_follows_the_snr_however_large(make_scenario, snr_db):
    simulator = Simulator(make_scenario())
    expected = simulator.scenario.scatterers.total_amplitude * 10.0 ** (-snr_db / 20)
    assert simulator.noise_amplitude(snr_db) == pytest.approx(expected, rel=1e-12, abs=1e-150)
    assert np.isfinite(simulator.observe(snr_db).cells).all()


def test_noise_is_circular_and_gaussian():
    noise = unit_noise("few", 0, 0, (20, 20, 4, 4))
    deviation = 1 / np.sqrt(noise.size)
    assert abs(np.mean(noise)) < SIGMAS * deviation
    assert abs(np.mean(noise**2)) < SIGMAS * np.sqrt(2) * deviation
    assert abs(np.mean(np.abs(noise) ** 4) - 2) < SIGMAS * np.sqrt(20) * deviation
    assert abs(np.mean(np.abs(noise) ** 2 > np.log(2)) - 0.5) < SIGMAS * 0.5 * deviation


@given(st.floats(-100, 100))
def test_the_snr_is_the_sum_of_single_echo_powers_over_the_noise_power(make_scenario, snr_db):
    noise_power = Simulator(make_scenario(amplitude=[1.0, 2.0, 0.5])).noise_power(snr_db)
    assert 10 * np.log10((1.0 + 4.0 + 0.25) / noise_power) == pytest.approx(snr_db)


@pytest.mark.parametrize("amplitude", [[], [0.0]])
def test_a_scene_without_echoes_has_the_noise_of_one_unit_scatterer(make_scenario, amplitude):
    n = len(amplitude)
    empty = make_scenario(xyz=np.full((n, 3), 1.0), velocity=np.zeros(n), amplitude=amplitude)
    assert Simulator(empty).noise_power(10.0) == pytest.approx(0.1)
    assert np.abs(Simulator(empty).clean).max() == 0
    assert np.abs(resource_grid(empty, [(0, 0), (1, 2)])).max() == 0


@pytest.mark.parametrize("frame", ["panel", "paper"])
def test_an_observation_is_the_echo_and_noise_of_its_power_whatever_was_asked_before(make_scenario, frame):
    scenario = make_scenario(frame, coherent_phase=frame == "panel")
    reused = Simulator(scenario)
    echo = reused.clean
    for snr_db, trial, seed in ((-20.0, 0, 0), (10.0, 0, 0), (0.0, 3, 1), (math.inf, 1, 0), (10.0, 0, 0)):
        found = reused.observe(snr_db, trial, seed).cells
        noise = unit_noise("few", trial, seed, found.shape)
        fresh = np.sqrt(reused.noise_power(snr_db)) * noise + clean_echo(scenario, reused.gate)
        np.testing.assert_array_equal(found, fresh)
        np.testing.assert_array_equal(observe_echo(scenario, snr_db, trial, seed).cells, fresh)
    assert reused.clean is echo


@pytest.mark.parametrize("is_transformed", [False, True])
def test_noise_in_the_gate_has_the_law_of_transformed_noise_of_the_whole_grid(is_transformed):
    noise, chance = unit_noise("gate", 0, 0, (24, 16, 4, 3)), 1e-6
    if is_transformed:
        cells = range_doppler_map(unit_noise("grid", 0, 0, (128, 56, 4, 3)))
        noise = cells[np.ix_(np.arange(-4, 20) % 128, np.arange(-8, 8) % 56)]
    power = np.abs(noise) ** 2
    n = noise.size
    # Twice a power is chi-square with two degrees of freedom.
    for axes in (range(4), *itertools.combinations(range(4), 3)):
        sums = power.sum(axis=tuple(axes))
        low, high = chi2.ppf([chance, 1 - chance], 2 * n / sums.size)
        assert ((low < 2 * sums) & (2 * sums < high)).all()
    low, high = binom.interval(1 - chance, n, math.exp(-2))
    assert low <= np.count_nonzero(power > 2) <= high
    for axis in range(4):
        n_pairs = noise.shape[axis] // 2
        even, odd = (np.take(noise, range(first, 2 * n_pairs, 2), axis) for first in (0, 1))
        share = abs(np.vdot(even, odd)) ** 2 / (np.linalg.norm(even) * np.linalg.norm(odd)) ** 2
        # Of two independent vectors it is beta(1, n - 1).
        assert (1 - share) ** (even.size - 1) > chance


def test_noise_differs_between_trials_seeds_and_scenarios_and_between_nothing_else(make_scenario):
    def draw(name="few", **which):
        simulator = Simulator(make_scenario(name=name))
        return simulator.observe(0.0, **which).cells - simulator.clean

    draws = [draw(), draw(trial=1), draw(seed=1), draw(name="other"), draw(trial=1, seed=1)]
    for index, one in enumerate(draws):
        for other in draws[:index]:
            correlation = np.vdot(one, other) / np.linalg.norm(one) / np.linalg.norm(other)
            assert abs(correlation) < SIGMAS / np.sqrt(one.size)
    np.testing.assert_array_equal(unit_noise("few", 0, 0, (3, 2)), unit_noise("few", 0, 0, (3, 2)))


@pytest.mark.parametrize(("name", "value"), [("trial", -1), ("seed", -1), ("trial", 1.5)])
def test_draws_that_no_whole_number_tells_are_refused(make_scenario, name, value):
    with pytest.raises(InputError, match=f"^{name} = {value}: allowed is a whole number of 0 and more$"):
        observe_echo(make_scenario(), 0.0, **{name: value})


def test_every_purpose_has_a_stream_of_its_own_beside_the_noise():
    streams = [(), ("place",), ("echo",), ("place", "echo")]
    draws = [random_stream("few", 0, 0, *purpose).standard_normal(1000) for purpose in streams]
    np.testing.assert_array_equal(draws[1], random_stream("few", 0, 0, "place").standard_normal(1000))
    correlation = np.corrcoef(draws) - np.eye(4)
    assert np.abs(correlation).max() < SIGMAS / math.sqrt(1000)
    noise = random_stream("few", 0, 0).standard_normal((3, 2)) * math.sqrt(0.5)
    np.testing.assert_array_equal(unit_noise("few", 0, 0, (3,)), noise[:, 0] + 1j * noise[:, 1])


@pytest.mark.parametrize("scatterers_a_speed", [1, 3, 20])
def test_summing_the_echoes_of_each_speed_first_changes_nothing(monkeypatch, scatterers_a_speed):
    street = load_scenario("street")
    rng = np.random.default_rng(scatterers_a_speed)
    n = 60
    scatterers = Scatterers(
        rng.uniform(street.region.lower_m, street.region.upper_m, (n, 3)),
        np.repeat(rng.uniform(-15, 15, n // scatterers_a_speed), scatterers_a_speed),
        rng.uniform(0.1, 1, n),
        rng.uniform(0, 6, n),
    )
    scenario = dataclasses.replace(street, scatterers=scatterers)
    monkeypatch.setattr(echo, "FEW_SPEEDS", n + 1)
    apart = clean_echo(scenario, gate_of(scenario))
    monkeypatch.setattr(echo, "FEW_SPEEDS", 0)
    together = clean_echo(scenario, gate_of(scenario))
    assert np.abs(together - apart).max() <= 1e-13 * np.abs(apart).max()
