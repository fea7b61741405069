"""Observations through a link: what unequal symbols and a part of the grid make of the gate's cells."""

import dataclasses
import importlib
import itertools
import re
import sys
import unittest.mock
from contextlib import nullcontext

import numpy as np
import pytest

import isacbench
from isacbench.cli.image_commands import DEFAULT_SNR
from isacbench.errors import InputWarning
from isacbench.link.sensing import link_observation
from isacbench.link.sensing.division import Signal, symbol_moduli
from isacbench.link.sensing.link_observation import SignalSimulator, weighted_echo
from isacbench.link.sensing.observing import observe
from isacbench.link.waveform.resource_grid import draw_grid
from isacbench.model.echo import Simulator, resource_grid
from isacbench.model.numerology import System
from isacbench.model.scene import Scatterers
from isacbench.model.scenes.scenario import load_scenario
from tests.conftest import refusal
from tests.gated_cells import cells_in_gate, gate_of

ESTIMATORS = ["fft4d", "music2d", "music2d_joint", "esprit2d", "nomp4d", "sbl4d", "oracle"]
DIVISIONS = ["reciprocal", "matched", "wiener"]
SIGNALS = [
    *(Signal(sensing="prs"), Signal("16qam")),
    *(Signal("64qam", division="matched"), Signal("256qam", division="wiener")),
]
EACH_SIGNAL = pytest.mark.parametrize("signal", SIGNALS)
EACH_DIVISION = pytest.mark.parametrize("division", DIVISIONS)


@pytest.fixture
def scenario(tiny):
    return load_scenario(tiny)


def random_weight(system):
    return np.random.default_rng(0).uniform(0, 2, (system.n_subcarriers, system.n_symbols))


def crowd(scenario, n, n_speeds):
    """Scene of so many scatterers and speeds."""
    rng = np.random.default_rng(n)
    xyz = rng.uniform([0, 0, 0], [10, 10, 5], (n, 3))
    speeds = rng.uniform(-15, 15, n_speeds)[np.arange(n) % max(n_speeds, 1)] if n else np.empty(0)
    scatterers = Scatterers(xyz, speeds, rng.uniform(0.5, 2, n), rng.uniform(0, 6, n))
    return dataclasses.replace(scenario, scatterers=scatterers)


@pytest.mark.parametrize(
    ("n", "n_speeds", "most_numbers"), [(0, 0, 1000), (1, 1, 2**23), (40, 2, 1000), (20, 20, 2**23)]
)
def test_weighted_cells_are_the_transform_of_the_weighted_grid(
    scenario, n, n_speeds, most_numbers, monkeypatch
):
    monkeypatch.setattr(link_observation, "MOST_NUMBERS", most_numbers)
    # A small grid, in blocks of few subcarriers, of one where every echo has a speed of its own.
    system = System(n_subcarriers=64, n_symbols=20)
    scene = dataclasses.replace(crowd(scenario, n, n_speeds), system=system)
    gate, weight = gate_of(scene), random_weight(system)
    cells = weighted_echo(scene, gate, weight)
    grid = resource_grid(scene, scene.array.positions) * weight[:, :, None]
    expected = cells_in_gate(grid, gate).reshape(cells.shape)
    np.testing.assert_allclose(cells, expected, atol=1e-12 * max(np.abs(expected).max(), 1))


def test_echoes_that_cancel_leave_nothing_behind_weights_either(scenario):
    pair = Scatterers(np.array([[3.0, 3.0, 1.0]] * 2), np.zeros(2), np.ones(2), np.array([0.0, np.pi]))
    scene = dataclasses.replace(scenario, scatterers=pair)
    assert not weighted_echo(scene, gate_of(scene), random_weight(scene.system)).any()


@EACH_SIGNAL
def test_noise_free_cells_are_those_of_the_divided_resource_grid(scenario, signal):
    system = scenario.system
    snr_db = np.inf if signal.division != "wiener" else 10.0
    gate, mask = gate_of(scenario), symbol_moduli(system, signal, trial=3, seed=1) > 0
    sent = draw_grid(system, signal.modulation, trial=3, seed=1).symbols
    received = sent[:, :, None] * resource_grid(scenario, scenario.array.positions)
    divisor = {
        "reciprocal": 1 / sent,
        "matched": sent.conj(),
        "wiener": sent.conj() / (np.abs(sent) ** 2 + 10 ** (-snr_db / 10)),
    }[signal.division] * mask
    divided = divisor[:, :, None] * received / np.mean(divisor * sent).real
    expected = cells_in_gate(divided, gate)
    cells = SignalSimulator(scenario, signal).echo_cells(snr_db, trial=3, seed=1)
    np.testing.assert_allclose(cells.reshape(expected.shape), expected, atol=1e-12 * np.abs(expected).max())


@EACH_DIVISION
def test_unit_modulus_on_the_whole_grid_is_the_observation_without_a_link_bit_for_bit(
    scenario, division, monkeypatch
):
    plain = Simulator(scenario).observe(3.0, trial=2, seed=5).cells
    for call in (observe, isacbench.observe):
        assert np.array_equal(call(scenario, 3.0, 2, 5, division=division).cells, plain)
    # And the long way, through equal weights, gives the same to rounding.
    monkeypatch.setattr(Signal, "is_plain", property(lambda _: False))
    monkeypatch.setattr(Signal, "has_unit_modulus", property(lambda _: False))
    long_way = SignalSimulator(scenario, Signal(division=division)).observe(3.0, trial=2, seed=5).cells
    np.testing.assert_allclose(long_way, plain, atol=1e-11 * np.abs(plain).max())


@EACH_SIGNAL
def test_without_noise_cells_are_the_echo_alone_and_read_only(scenario, signal):
    simulator = SignalSimulator(scenario, signal)
    cells = simulator.observe(np.inf).cells
    assert np.array_equal(cells, simulator.echo_cells(np.inf))
    assert not cells.flags.writeable


@EACH_SIGNAL
def test_noise_has_the_power_that_division_leaves(scenario, signal):
    simulator = SignalSimulator(scenario, signal)
    snr_db = -5.0
    trials = range(6)
    noise = [simulator.observe(snr_db, one).cells - simulator.echo_cells(snr_db, one) for one in trials]
    factors = [simulator.weights(snr_db, one).noise ** 2 for one in trials]
    expected = simulator.noise_power(snr_db) * np.mean(factors)
    # Noise of the PRS has few degrees of freedom along Doppler; 16 elements, 6 trials.
    n_free = 6 * 16 * simulator.gate.shape[0] * 4
    assert np.mean(np.abs(noise) ** 2) == pytest.approx(expected, rel=5 / np.sqrt(n_free))


@EACH_SIGNAL
def test_noise_is_that_of_the_trial_scaled_and_follows_the_canonical_draw(scenario, signal):
    simulator = SignalSimulator(scenario, signal)
    noise = simulator.noise_cells(0.0, trial=1)
    assert np.array_equal(SignalSimulator(scenario, signal).noise_cells(0.0, trial=1), noise)
    assert not np.allclose(simulator.noise_cells(0.0, trial=2), noise)
    white = simulator.unit_noise(1, 0)
    correlation = np.vdot(white, noise).real / np.linalg.norm(white) / np.linalg.norm(noise)
    # Of the PRS 48 symbols in 224 are left, in this small frame 12 in 32.
    assert correlation > (0.5 if signal.sensing == "prs" else 0.85)


def test_what_changes_neither_with_trial_nor_with_snr_is_computed_once(scenario, monkeypatch):
    n_echoes = []
    whole = link_observation.weighted_echo
    monkeypatch.setattr(link_observation, "weighted_echo", lambda *of: n_echoes.append(1) or whole(*of))
    observations = [(snr_db, trial) for trial in range(2) for snr_db in (0.0, 10.0)]
    for signal, expected in [
        (Signal("64qam"), 0),
        (Signal("64qam", "prs", "wiener"), 1),
        (Signal("64qam", division="matched"), 2),
        (Signal("64qam", division="wiener"), 4),
    ]:
        n_echoes.clear()
        simulator = SignalSimulator(scenario, signal)
        for snr_db, trial in observations:
            simulator.observe(snr_db, trial)
        assert len(n_echoes) == expected


def test_self_noise_of_matched_division_is_a_pedestal_of_known_height(scenario):
    simulator = SignalSimulator(scenario, Signal("16qam", division="matched"))
    echoes = np.array([simulator.echo_cells(np.inf, trial) for trial in range(8)])
    power = np.mean(np.abs(echoes - simulator.clean) ** 2)
    total = np.sum(scenario.scatterers.amplitude**2)
    # Data alone vary: E|X|⁴ - 1 = 0.32 of 16QAM, on all elements but those of the PRS.
    share = 1 - 64 * 12 / (256 * 32)
    assert power == pytest.approx(0.32 * share * total, rel=0.05)


# The PRS alone is imaged in test_prs_images.py. Each of the others has a third of the estimators.
@pytest.mark.parametrize("number", [1, 2, 3])
def test_every_estimator_images_a_signal_of_unequal_symbols(scenario, number):
    from isacbench.bench.cells.images import estimate_cloud

    observation = SignalSimulator(scenario, SIGNALS[number]).observe(15.0)
    strongest = scenario.truth.xyz[scenario.scatterers.amplitude.argmax()]
    for name in ESTIMATORS[number - 1 :: 3]:
        cloud = estimate_cloud(isacbench.get_estimator(name), observation, scenario.truth)
        assert len(cloud), name
        assert all(np.isfinite(values).all() for values in (cloud.xyz, cloud.velocity, cloud.power)), name
        # The strongest scatterer is found where it is, whatever is sensed with.
        assert np.linalg.norm(cloud.xyz - strongest, axis=1).min() < 2.5, name


@EACH_SIGNAL
def test_a_recorded_frame_that_was_divided_so_is_observed_alike(scenario, signal):
    system, snr_db = scenario.system, 10.0
    simulator = SignalSimulator(scenario, signal)
    weight = simulator.weights(snr_db).echo
    grid = resource_grid(scenario, scenario.array.positions).reshape(*weight.shape, 4, 4)
    recorded = isacbench.observe_cube(weight[:, :, None, None] * grid, scenario)
    expected = simulator.echo_cells(snr_db)
    has_all = weight.any(axis=0).all() and weight.any(axis=1).all()
    with nullcontext() if has_all else pytest.warns(InputWarning, match="symbols .* hold zeros alone"):
        cells = recorded.cells
    np.testing.assert_allclose(cells, expected, atol=1e-12 * np.abs(expected).max())
    if weight.all():
        # Or as the division of a received frame, here by what Y X*/... is the reciprocal of.
        sent = draw_grid(system, signal.modulation).symbols
        received = sent[:, :, None, None] * grid
        divided = isacbench.observe_cube(received, scenario, transmitted=sent / weight)
        np.testing.assert_allclose(divided.cells, expected, atol=1e-12 * np.abs(expected).max())


def test_a_scenario_is_observed_by_its_name_alone_at_the_snr_of_the_command():
    by_name = isacbench.observe("single")
    assert np.array_equal(by_name.cells, isacbench.observe("single", float(DEFAULT_SNR)).cells)


def test_what_is_no_scenario_or_no_number_is_refused(scenario):
    for scene in (None, 5, b"street", ["street"]):
        message = refusal(isacbench.observe, scene, 10)
        assert message.endswith(f"a name, a path or a Scenario, not {type(scene).__name__}")
    for snr_db, sensing in itertools.product([None, "10", [10.0], float("nan")], ["all", "prs"]):
        message = rf"snr_db = {re.escape(repr(snr_db))}: allowed is -\d+ and more, infinity for no noise"
        assert re.search(message, refusal(isacbench.observe, scenario, snr_db, sensing=sensing))


def test_an_observation_without_a_link_does_not_load_one():
    others = {name: one for name, one in sys.modules.items() if name.partition(".")[0] != "isacbench"}
    with unittest.mock.patch.dict(sys.modules, others, clear=True):
        anew = importlib.import_module("isacbench")
        anew.observe(anew.load_scenario("single"), 10)
        assert "isacbench.link.sensing.observing" in sys.modules
        assert "isacbench.link.sensing.link_observation" not in sys.modules
