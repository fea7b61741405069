"""Noise of the transmitted signal: every echo carries the same, from its own place and direction."""

import cmath
import dataclasses
import math

import numpy as np
import pytest

from isacbench.bench.kinds.efficiency import EfficiencyKind
from isacbench.bench.kinds.link import LinkKind
from isacbench.bench.suites.scenario_digest import scenario_digest
from isacbench.bench.suites.suite_kinds import load_suite
from isacbench.errors import InputError
from isacbench.link.sensing.observing import observe
from isacbench.model.echo import Simulator, echo_parameters, transmitted_noise
from isacbench.model.numerology import System
from isacbench.model.radio_coordinates import gain_db
from isacbench.model.scenes.scenario import load_scenario
from tests.gated_cells import cells_in_gate

SIGMAS = 5.0


@pytest.fixture
def noisy(make_scenario):
    """Return a function that builds scenes whose transmitted signal is noisy."""

    def build(**given):
        return make_scenario(**{"noise": "transmitter", "n_subcarriers": 32, "n_symbols": 12, **given})

    return build


def noise_of(scenario, snr_db=0.0, **which):
    simulator = Simulator(scenario)
    return simulator.observe(snr_db, **which).cells - simulator.clean


@pytest.mark.parametrize("frame", ["panel", "paper"])
def test_cells_are_the_transform_of_echoes_times_the_noisy_signal(noisy, frame):
    scenario = noisy(frame=frame, coherent_phase=True)
    system, scatterers, (n_p, n_q) = scenario.system, scenario.scatterers, scenario.array.shape
    gain = [1.0, 0.6, 2.5] * np.exp(-4j * np.pi * system.carrier_hz / 299_792_458.0 * scenario.range_m)
    u, w = scenario.frame.direction_cosines(scatterers.xyz - scenario.base_station_m)
    factor = 1 + math.sqrt(0.1) * scatterers.total_amplitude * transmitted_noise(scenario, 2, 1)
    grid = np.zeros((32, 12, n_p, n_q), dtype=complex)
    for k in range(3):
        for n, m, p, q in np.ndindex(grid.shape):
            delay = n * scenario.range_m[k] / system.unambiguous_range_m
            doppler = m * scatterers.velocity[k] / (2 * system.unambiguous_speed_mps)
            turns = doppler - delay - (p * u[k] + q * w[k]) / 2
            grid[n, m, p, q] += gain[k] * cmath.exp(2j * math.pi * turns) * factor[n, m]
    observation = Simulator(scenario).observe(10.0, 2, 1)
    expected = cells_in_gate(grid, observation.gate)
    np.testing.assert_allclose(observation.cells, expected, atol=1e-10 * np.abs(expected).max())


def test_noise_of_a_lone_scatterer_comes_from_its_direction_and_has_its_power_over_the_snr(noisy):
    scenario = noisy(xyz=[[5.1, 6.7, 1.9]], velocity=[3.0], amplitude=[0.6], n_symbols=56, n_subcarriers=512)
    noise = noise_of(scenario, 7.0)
    echo = echo_parameters(scenario)
    p, q = np.indices(scenario.array.shape)
    steering = np.exp(-1j * np.pi * (p * echo.u[0] + q * echo.w[0]))
    np.testing.assert_allclose(noise, noise[:, :, :1, :1] * steering, atol=1e-10)
    power = np.abs(noise[..., 0, 0]) ** 2 / (0.36 * 10**-0.7)
    assert power.mean() == pytest.approx(1, abs=SIGMAS / math.sqrt(power.size))
    # So it lies below the peak by the SNR and the gain of the transforms, whatever the number of elements.
    assert gain_db(scenario) == pytest.approx(10 * math.log10(512 * 56))
    assert gain_db(scenario) == gain_db(noisy(n_symbols=56, n_subcarriers=512))


def test_real_noise_in_time_divided_by_qpsk_is_white_and_circular_on_resource_elements():
    n_frames, n_subcarriers, n_symbols, n_prefix, snr = 20000, 8, 3, 2, 4.0
    rng = np.random.default_rng(1)
    shape = n_frames, n_symbols, n_subcarriers
    sent = np.exp(1j * np.pi * (rng.integers(0, 4, shape) / 2 + 1 / 4))
    useful = np.fft.ifft(sent, norm="ortho")
    waveform = np.concatenate([useful[..., -n_prefix:], useful], axis=2)
    noise = rng.standard_normal(waveform.shape) * np.sqrt(np.mean(np.abs(waveform) ** 2) / snr)
    received = np.fft.fft((waveform + noise)[..., n_prefix:], norm="ortho")
    relative = (received / sent - 1).reshape(n_frames, -1)
    # With their conjugates: covariances and those without conjugation, which circular noise does not have.
    both = np.concatenate([relative, relative.conj()], axis=1)
    covariance = snr * both.T @ both.conj() / n_frames
    assert np.abs(covariance - np.eye(len(covariance))).max() < SIGMAS * math.sqrt(2 / n_frames)
    drawn = np.stack([transmitted_noise(load_scenario("single"), 0, seed) for seed in range(2)])
    assert np.mean(np.abs(drawn) ** 2) == pytest.approx(1, abs=0.01)
    assert abs(np.mean(drawn**2)) < 0.01
    assert abs(np.mean(drawn[0] * drawn[1].conj())) < 0.01


def test_the_snr_only_scales_noise_that_scenario_trial_and_seed_determine(noisy):
    noise = noise_of(noisy(), trial=3)
    np.testing.assert_allclose(noise_of(noisy(), 20.0, trial=3), 0.1 * noise, atol=1e-12)
    np.testing.assert_array_equal(noise_of(noisy(), trial=3), noise)
    for other in (noise_of(noisy(), trial=4), noise_of(noisy(), trial=3, seed=1)):
        assert np.abs(other - noise).max() > 0.1
    assert not noise_of(noisy(amplitude=[0.0] * 3)).any()


def test_a_scene_too_large_for_memory_is_summed_in_parts(noisy, monkeypatch):
    expected = noise_of(noisy())
    monkeypatch.setattr("isacbench.model.echo.MOST_PRODUCTS", 1)
    np.testing.assert_allclose(noise_of(noisy()), expected, atol=1e-12)


def test_the_option_is_part_of_the_identity_only_where_it_changes_something(noisy):
    plain, own = noisy(noise="receiver"), noisy()
    assert plain.system == dataclasses.replace(own.system, noise="receiver")
    assert len({scenario_digest(one) for one in (plain, own)}) == 2
    street = load_scenario("street-transmitter-noise")
    assert street.system.noise == "transmitter"
    renamed = dataclasses.replace(
        street, name="street", system=dataclasses.replace(street.system, noise="receiver")
    )
    assert scenario_digest(renamed) == scenario_digest(load_scenario("street"))


def test_what_takes_noise_to_be_the_receivers_refuses_another(noisy):
    scenario = noisy()
    for refused, task in (
        (lambda: observe(scenario, 10.0, sensing="prs"), "the PRS alone and unequal symbols"),
        (lambda: LinkKind().tasks(load_suite("link"), {"few": scenario}), "a suite of the kind link"),
        (lambda: EfficiencyKind().tasks(load_suite("efficiency"), {"few": scenario}), "the Cramér-Rao bound"),
    ):
        expected = rf"^\[system\] noise = 'transmitter': allowed is 'receiver' for {task}$"
        with pytest.raises(InputError, match=expected):
            refused()
    with pytest.raises(InputError, match="noise = 'transmiter': allowed is receiver and transmitter"):
        System(noise="transmiter")
