"""The echo through its waveform is the closed form, up to what theory says of Doppler."""

import dataclasses

import numpy as np
import pytest

from isacbench import get_estimator, load_scenario, observe, score
from isacbench.link.waveform.resource_grid import draw_grid
from isacbench.model.array import VirtualArray
from isacbench.model.echo import resource_grid
from isacbench.model.numerology import SPEED_OF_LIGHT_MPS, System
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers
from tests.algorithms.scenes import EMPTY
from tests.link.sensing.echo_waveform import echo_symbols, waveform_cells

NEAR = np.array([[1.3, 2.2, 0.4], [5.1, 6.7, 1.9], [8.8, -60.4, 4.6]])
ELEMENTS = [(0, 0), (3, 1), (2, 3)]


def leakage(doppler_ratio, n):
    """Amplitudes (received, sent) with which Doppler within a symbol brings subcarriers to each other."""
    turned = np.exp(2j * np.pi * doppler_ratio * (np.arange(n) - (n - 1) / 2) / n)
    waves = np.fft.ifft(np.eye(n), axis=0, norm="ortho")
    return np.fft.fft(turned[:, None] * waves, axis=0, norm="ortho")


def scene(xyz=NEAR, velocity=0.0, amplitude=1.0, **system):
    """Scatterers in front of a 4 x 4 array."""
    xyz = np.reshape(xyz, (-1, 3))
    n = len(xyz)
    return dataclasses.replace(
        EMPTY,
        system=System(n_subcarriers=64, n_symbols=8, **system),
        array=VirtualArray((2, 2), (2, 2), 2, 1),
        base_station_m=np.array([5.0, 40.0, 10.0]),
        region=Region((0.0, 10.0), (-70.0, 10.0), (0.0, 5.0), (-200.0, 200.0)),
        scatterers=Scatterers(xyz, np.broadcast_to(velocity, n), np.broadcast_to(amplitude, n)),
    )


def divided_grid(scenario, modulation):
    """Demodulated grid (n, m, e) over the symbols sent, and the frame sent."""
    grid = draw_grid(scenario.system, modulation)
    return echo_symbols(scenario, grid, ELEMENTS) / grid.symbols[:, :, None], grid


@pytest.mark.parametrize("coherent_phase", [False, True])
@pytest.mark.parametrize("modulation", ["qpsk", "16qam", "64qam", "256qam"])
def test_a_still_scene_within_the_prefix_is_the_closed_form(modulation, coherent_phase):
    scenario = scene(amplitude=[1.0, 0.6, 2.5], coherent_phase=coherent_phase)
    divided, _ = divided_grid(scenario, modulation)
    np.testing.assert_allclose(divided, resource_grid(scenario, ELEMENTS), rtol=0, atol=1e-12)


def test_a_moving_scene_is_the_closed_form_with_the_leakage_that_theory_has():
    """Every echo leaks from all subcarriers to all others."""
    scenario = scene(velocity=[30.0, -190.0, 3.0], amplitude=[1.0, 0.6, 2.5])
    divided, grid = divided_grid(scenario, "64qam")
    expected = np.zeros_like(divided)
    n_subcarriers = scenario.system.n_subcarriers
    for k in range(len(NEAR)):
        alone = scene(NEAR[k], scenario.scatterers.velocity[k], scenario.scatterers.amplitude[k])
        echo = resource_grid(alone, ELEMENTS)
        doppler_hz = 2 * alone.scatterers.velocity[0] * alone.system.carrier_hz / SPEED_OF_LIGHT_MPS
        ratio = doppler_hz / alone.system.subcarrier_spacing_hz
        sent = grid.symbols[:, :, None] * echo
        expected += np.tensordot(leakage(ratio, n_subcarriers), sent, 1) / grid.symbols[:, :, None]
    np.testing.assert_allclose(divided, expected, rtol=0, atol=2e-12)


@pytest.mark.parametrize("division", ["reciprocal", "matched", "wiener"])
@pytest.mark.parametrize("sensing", ["all", "prs"])
def test_an_observation_of_a_still_scene_is_that_of_the_closed_form(sensing, division):
    signal = {"modulation": "256qam", "sensing": sensing, "division": division}
    scenario = scene()
    expected = observe(scenario, np.inf, trial=1, **signal)
    cells = waveform_cells(scenario, trial=1, **signal)
    np.testing.assert_allclose(cells, expected.cells, rtol=0, atol=1e-12 * np.abs(expected.cells).max())
    assert expected.sensing == sensing


@pytest.mark.slow
def test_the_street_through_its_waveform_is_imaged_as_in_closed_form():
    street, estimator = load_scenario("street-8x8"), get_estimator("music2d")
    closed = observe(street, np.inf)
    waveform = dataclasses.replace(closed, cells=waveform_cells(street))
    found, expected = (
        score(street.truth, estimator.estimate(one))["deviation"] for one in (waveform, closed)
    )
    assert found == pytest.approx(expected, abs=0.02)
