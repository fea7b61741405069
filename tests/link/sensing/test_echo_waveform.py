"""The echo through its waveform is the closed form, up to what theory says of Doppler and of late echoes."""

import dataclasses
import warnings

import numpy as np
import pytest

from isacbench import get_estimator, load_scenario, observe, score
from isacbench.dsp.rangedoppler import range_doppler_map
from isacbench.errors import InputWarning
from isacbench.link.sensing.division import Signal
from isacbench.link.sensing.link_observation import SignalSimulator
from isacbench.link.waveform.qam import constellation
from isacbench.link.waveform.resource_grid import draw_grid
from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator, resource_grid
from isacbench.model.frame import get_frame
from isacbench.model.numerology import SPEED_OF_LIGHT_MPS, System
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers, Scenario
from tests.link.sensing.echo_waveform import echo_paths, echo_symbols, waveform_cells
from tests.link.sensing.interference import echo_interference

NEAR = np.array([[1.3, 2.2, 0.4], [5.1, 6.7, 1.9], [8.8, -60.4, 4.6]])
FAR = np.array([[5.0, -130.0, 2.0], [6.0, -200.0, 1.0]])
ELEMENTS = [(0, 0), (3, 1), (2, 3)]


def leakage(doppler_ratio, n):
    """Amplitudes (received, sent) with which Doppler within a symbol brings subcarriers to each other."""
    turned = np.exp(2j * np.pi * doppler_ratio * (np.arange(n) - (n - 1) / 2) / n)
    waves = np.fft.ifft(np.eye(n), axis=0, norm="ortho")
    return np.fft.fft(turned[:, None] * waves, axis=0, norm="ortho")


def mean_inverse_power(modulation):
    """Factor by which division by the symbols strengthens interference."""
    return np.mean(1 / np.abs(constellation(modulation)) ** 2)


def scene(xyz=NEAR, velocity=0.0, amplitude=1.0, name="few", **system):
    """Scatterers in front of a 4 x 4 array, in a region that reaches beyond the cyclic prefix."""
    xyz = np.asarray(xyz, dtype=float).reshape(-1, 3)
    n = len(xyz)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        return Scenario(
            name=name,
            system=System(**{"n_subcarriers": 64, "n_symbols": 8, **system}),
            array=VirtualArray((2, 2), (2, 2), 2, 1),
            frame=get_frame("panel"),
            base_station_m=np.array([5.0, 40.0, 10.0]),
            region=Region((0.0, 10.0), (-210.0, 10.0), (0.0, 5.0), (-200.0, 200.0)),
            scatterers=Scatterers(xyz, np.broadcast_to(velocity, n), np.broadcast_to(amplitude, n)),
        )


def divided_grid(scenario, modulation="qpsk", elements=ELEMENTS):
    """Demodulated grid (n, m, e) over the symbols sent, and the frame sent."""
    grid = draw_grid(scenario.system, modulation)
    return echo_symbols(scenario, grid, elements) / grid.symbols[:, :, None], grid


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


@pytest.mark.parametrize("modulation", ["qpsk", "16qam"])
def test_the_error_of_a_moving_scene_has_the_power_that_theory_has(modulation):
    scenario = scene(NEAR[1], velocity=60.0, n_subcarriers=512, n_symbols=60)
    divided, grid = divided_grid(scenario, modulation, [(1, 2)])
    error = np.abs(divided - resource_grid(scenario, [(1, 2)]))[:, :, 0][~grid.is_prs] ** 2
    gain, power = echo_interference(scenario.system, scenario.range_m[0], 60.0)
    expected = np.abs(1 - gain) ** 2 + mean_inverse_power(modulation) * power
    assert error.mean() == pytest.approx(expected, abs=5 * error.std() / np.sqrt(error.size))


@pytest.mark.parametrize("velocity_mps", [0.0, 40.0])
def test_a_late_echo_fades_and_interferes_as_theory_has_it(velocity_mps):
    scenario = scene(FAR[1], velocity=velocity_mps, n_subcarriers=512, n_symbols=60)
    divided, _ = divided_grid(scenario, elements=[(0, 0)])
    # The closed form, turn by turn of range, is the same for late echoes.
    ratio = (divided / resource_grid(scenario, [(0, 0)]))[:, 1:, 0]
    gain, expected = echo_interference(scenario.system, scenario.range_m[0], velocity_mps)
    power = np.abs(ratio - gain) ** 2
    assert power.mean() == pytest.approx(expected, abs=5 * power.std() / np.sqrt(power.size))
    assert ratio.mean() == pytest.approx(gain, abs=5 * np.sqrt(power.mean() / power.size))
    assert expected > 0.1


@pytest.mark.parametrize(("modulation", "division"), [("16qam", "reciprocal"), ("256qam", "wiener")])
def test_the_cells_of_a_moving_scene_are_those_of_the_divided_echo(modulation, division):
    # So few symbols that their mean power is not that of the constellation.
    scenario = scene(velocity=[3.0, -19.0, 0.3], n_subcarriers=32, n_symbols=8)
    signal = {"modulation": modulation, "division": division, "trial": 2, "seed": 1}
    weights = SignalSimulator(scenario, Signal(modulation, division=division)).weights(3.0, 2, 1)
    grid = draw_grid(scenario.system, modulation, trial=2, seed=1)
    divisor = weights.noise * np.exp(-1j * np.angle(grid.symbols))
    rdm = range_doppler_map(echo_symbols(scenario, grid, scenario.array.positions) * divisor[:, :, None])
    gate = Simulator(scenario).gate
    expected = rdm[np.ix_(gate.range_bins % 32, gate.doppler_bins % 8)]
    cells = waveform_cells(scenario, snr_db=3.0, **signal)
    np.testing.assert_allclose(cells, expected.reshape(cells.shape), rtol=0, atol=1e-10)


@pytest.mark.parametrize("division", ["reciprocal", "matched", "wiener"])
@pytest.mark.parametrize("sensing", ["all", "prs"])
def test_an_observation_of_a_still_scene_is_that_of_the_closed_form(sensing, division):
    signal = {"modulation": "256qam", "sensing": sensing, "division": division}
    scenario = scene()
    expected = observe(scenario, np.inf, trial=1, **signal)
    cells = waveform_cells(scenario, trial=1, **signal)
    np.testing.assert_allclose(cells, expected.cells, rtol=0, atol=1e-12 * np.abs(expected.cells).max())
    assert expected.sensing == sensing


def test_delays_do_not_fold():
    system = System()
    range_m = system.unambiguous_range_m * 1.5
    scenario = scene([5.0, 40.0 - range_m, 9.0])
    assert echo_paths(scenario, [(0, 0)]).delay_s[0] > 1.5 / system.subcarrier_spacing_hz


@pytest.mark.slow
def test_the_street_through_its_waveform_is_imaged_as_in_closed_form():
    street = load_scenario("street-8x8")
    estimator = get_estimator("music2d")
    closed = observe(street, np.inf)
    echo = waveform_cells(street)
    observations = closed, dataclasses.replace(closed, cells=echo)
    through_closed_form, through_waveform = (
        score(street.truth, estimator.estimate(observation))["deviation"] for observation in observations
    )
    assert through_waveform == pytest.approx(through_closed_form, abs=0.02)
