"""The echo through its waveform is the closed form, up to what theory says of Doppler and of late echoes."""

import warnings

import numpy as np
import pytest

from isacbench import get_estimator, load_scenario, observe, score
from isacbench.dsp.rangedoppler import range_doppler_map
from isacbench.errors import InputError, InputWarning
from isacbench.link.sensing.division import Signal
from isacbench.link.sensing.echo_waveform import (
    echo_paths,
    interference_to_echo_db,
    observe_waveform,
    received_waveform,
)
from isacbench.link.sensing.interference import echo_interference
from isacbench.link.sensing.link_observation import SignalSimulator
from isacbench.link.waveform.ofdm import demodulate
from isacbench.link.waveform.qam import constellation
from isacbench.link.waveform.resource_grid import draw_grid
from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator, resource_grid
from isacbench.model.frame import get_frame
from isacbench.model.numerology import SPEED_OF_LIGHT_MPS, System
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers, Scenario

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
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        received = demodulate(received_waveform(scenario, grid, elements), scenario.system)
    return received / grid.symbols[:, :, None], grid


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
    found = echo_interference(scenario.system, scenario.range_m[0], 60.0)
    expected = np.abs(1 - found.useful_gain) ** 2 + mean_inverse_power(modulation) * found.power
    assert error.mean() == pytest.approx(expected, abs=5 * error.std() / np.sqrt(error.size))


@pytest.mark.parametrize("velocity_mps", [0.0, 40.0])
def test_a_late_echo_fades_and_interferes_as_theory_has_it(velocity_mps):
    scenario = scene(FAR[1], velocity=velocity_mps, n_subcarriers=512, n_symbols=60)
    divided, _ = divided_grid(scenario, elements=[(0, 0)])
    # The closed form, turn by turn of range, is the same for late echoes.
    ratio = (divided / resource_grid(scenario, [(0, 0)]))[:, 1:, 0]
    found = echo_interference(scenario.system, scenario.range_m, velocity_mps)
    power = np.abs(ratio - found.useful_gain) ** 2
    assert power.mean() == pytest.approx(found.power[0], abs=5 * power.std() / np.sqrt(power.size))
    assert ratio.mean() == pytest.approx(found.useful_gain[0], abs=5 * np.sqrt(power.mean() / power.size))
    assert found.power[0] > 0.1


@pytest.mark.parametrize(("modulation", "division"), [("16qam", "reciprocal"), ("256qam", "wiener")])
def test_an_observation_is_the_range_doppler_map_of_the_divided_waveform(modulation, division):
    # So few symbols that their mean power is not that of the constellation.
    scenario = scene(velocity=[30.0, -190.0, 3.0], n_subcarriers=32, n_symbols=8)
    grid = draw_grid(scenario.system, modulation, trial=2, seed=1)
    waveform = received_waveform(scenario, grid, scenario.array.positions, snr_db=3.0, trial=2, seed=1)
    weights = SignalSimulator(scenario, Signal(modulation, division=division)).weights(3.0, 2, 1)
    divisor = weights.noise * np.exp(-1j * np.angle(grid.symbols))
    cells = range_doppler_map(demodulate(waveform, scenario.system) * divisor[:, :, None])
    observation = observe_waveform(scenario, 3.0, 2, 1, modulation=modulation, division=division)
    gate = observation.gate
    expected = cells[np.ix_(gate.range_bins, gate.doppler_bins)].reshape(observation.cells.shape)
    np.testing.assert_allclose(observation.cells, expected, rtol=0, atol=1e-10)
    assert not observation.cells.flags.writeable


@pytest.mark.parametrize("division", ["reciprocal", "matched", "wiener"])
@pytest.mark.parametrize("sensing", ["all", "prs"])
def test_an_observation_of_a_still_scene_is_that_of_the_closed_form(sensing, division):
    signal = {"modulation": "256qam", "sensing": sensing, "division": division}
    scenario = scene()
    observation, expected = (see(scenario, np.inf, trial=1, **signal) for see in (observe_waveform, observe))
    scale = np.abs(expected.cells).max()
    np.testing.assert_allclose(observation.cells, expected.cells, rtol=0, atol=1e-12 * scale)
    assert observation.sensing == expected.sensing == sensing


def test_noise_has_the_stated_power_in_waveform_and_grid():
    scenario = scene(amplitude=[1.0, 2.0, 0.5], n_subcarriers=256, n_symbols=28)
    grid = draw_grid(scenario.system)
    clean = received_waveform(scenario, grid, ELEMENTS)
    noise = received_waveform(scenario, grid, ELEMENTS, snr_db=4.0, trial=1) - clean
    power = (1.0 + 4.0 + 0.25) / 10**0.4
    assert Simulator(scenario).noise_power(4.0) == pytest.approx(power)
    for values in (noise, demodulate(noise, scenario.system)):
        # The mean of n squared magnitudes has a relative spread of n^-1/2.
        assert np.mean(np.abs(values) ** 2) == pytest.approx(power, rel=5 / np.sqrt(values.size))
        assert np.abs(np.mean(values**2)) < 5 * power / np.sqrt(values.size)
    correlation = noise.conj().T @ noise / len(noise) / power
    np.testing.assert_allclose(correlation, np.eye(3), atol=5 / np.sqrt(len(noise)))


def test_noise_follows_from_scenario_trial_seed_and_element_alone():
    scenario, grid = scene(), draw_grid(scene().system)

    def noise(elements, snr_db=0.0, **which):
        echo = received_waveform(scenario, grid, elements)
        return received_waveform(scenario, grid, elements, snr_db, **which) - echo

    first = noise([(0, 0), (2, 1)], trial=1)
    np.testing.assert_allclose(first[:, 1:], noise([(2, 1)], trial=1), atol=1e-12)
    np.testing.assert_allclose(first, 10 * noise([(0, 0), (2, 1)], 20.0, trial=1), atol=1e-12)
    for other in (noise([(0, 0)], trial=2), noise([(0, 0)], trial=1, seed=1), noise([(1, 0)], trial=1)):
        assert np.abs(first[:, :1] - other).min() > 0


def test_an_empty_scene_is_noise_of_one_unit_scatterer():
    scenario = scene(np.zeros((0, 3)))
    assert not observe_waveform(scenario, np.inf).cells.any()
    cells = observe_waveform(scenario, 0.0).cells
    assert np.mean(np.abs(cells) ** 2) == pytest.approx(1, rel=5 / np.sqrt(cells.size))


@pytest.mark.parametrize("velocity_mps", [0.0, 17.0])
def test_echoes_that_cancel_leave_nothing_to_image(velocity_mps):
    scenario = scene([NEAR[0], NEAR[0]], velocity=velocity_mps, amplitude=[1.0, -1.0])
    assert not observe_waveform(scenario, np.inf).cells.any()


def test_delays_do_not_fold():
    system = System()
    range_m = system.unambiguous_range_m * 1.5
    scenario = scene([5.0, 40.0 - range_m, 9.0])
    assert echo_paths(scenario, [(0, 0)]).delay_s[0] > 1.5 / system.subcarrier_spacing_hz


def test_late_echoes_are_warned_of_with_their_interference():
    scenario = scene([*NEAR, *FAR], amplitude=[1, 1, 1, 2, 2])
    late = echo_interference(scenario.system, scenario.range_m[3:], 0.0)
    expected_db = 10 * np.log10(4 * late.power.sum() / (3 + 8))
    assert interference_to_echo_db(scenario) == pytest.approx(expected_db)
    words = (
        r"scenario few: echoes of 2 of 5 scatterers come from up to 103\.\d m beyond the 136\.6 m of the "
        rf"undisturbed cyclic prefix; their interference is at {expected_db:.1f} dB of all echoes"
    )
    with pytest.warns(InputWarning, match=words):
        observe_waveform(scenario, np.inf)
    with pytest.warns(InputWarning, match=words):
        received_waveform(scenario, draw_grid(scenario.system), [(0, 0)])


def test_echoes_within_the_prefix_are_not_warned_of():
    scenario = scene(velocity=100.0)
    assert interference_to_echo_db(scenario) == -np.inf
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        observe_waveform(scenario, np.inf)


def test_scatterers_without_echo_do_not_interfere():
    assert interference_to_echo_db(scene([*NEAR, *FAR], amplitude=[1, 1, 1, 0, 0])) == -np.inf
    assert interference_to_echo_db(scene(FAR, amplitude=0.0)) == -np.inf


@pytest.mark.parametrize("elements", [[(4, 0)], [(0, -1)], [(0.0, 1.0)], [0, 1], [(0, 1, 2)]])
def test_elements_of_no_array_are_refused(elements):
    with pytest.raises(InputError, match=r"allowed are pairs from \(0, 0\) to \(3, 3\)"):
        echo_paths(scene(), elements)


@pytest.mark.slow
def test_the_street_through_its_waveform_is_imaged_as_in_closed_form():
    street = load_scenario("street")
    estimator = get_estimator("music2d")
    # Measured 6.587 both without noise; at 10 dB, with draws of their own, 5.8 to 6.6: single points differ.
    for snr_db, tolerance in ((np.inf, 0.02), (10.0, 1.0)):
        observations = observe_waveform(street, snr_db), observe(street, snr_db)
        scores = [score(street.truth, estimator.estimate(observation)) for observation in observations]
        through_waveform, in_closed_form = (values["deviation"] for values in scores)
        assert through_waveform == pytest.approx(in_closed_form, abs=tolerance)
