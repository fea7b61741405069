"""Transmitters that take turns: less energy, repeated maps, and the phases of transmitters in between."""

import dataclasses

import numpy as np
import pytest

from isacbench.bench.kinds.link import LinkKind
from isacbench.bench.kinds.population import scene_bound
from isacbench.bench.suites.scenario_digest import scenario_digest
from isacbench.bench.suites.suite_kinds import load_suite
from isacbench.cubes.frame import observe_cube
from isacbench.cubes.image_cost import image_cost
from isacbench.cubes.writing import FrameSimulator
from isacbench.errors import InputError
from isacbench.link.sensing.noise_colouring import noise_covariance
from isacbench.link.sensing.observing import observe
from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator, clean_echo, resource_grid, transmitted_noise
from isacbench.model.radio_coordinates import gain_db
from isacbench.model.scenes.scenario import load_scenario
from isacbench.plugins.registry import get_estimator
from tests.gated_cells import cells_in_gate

ARRAYS = (
    VirtualArray((2, 2), (2, 2), 2, 1),
    VirtualArray((2, 1), (2, 3), 1, 1),
    VirtualArray((3, 1), (2, 4), 2),
)
MODES = pytest.mark.parametrize("mimo", ["comb", "tdm"])


@pytest.fixture
def taking_turns(make_scenario):
    """Return a function that builds scenes whose transmitters take turns."""

    def build(mimo, array=ARRAYS[0], **given):
        array = dataclasses.replace(array, mimo=mimo)
        return make_scenario(array=array, **{"n_subcarriers": 240, "n_symbols": 112, **given})

    return build


@MODES
@pytest.mark.parametrize("array", ARRAYS)
@pytest.mark.parametrize(("n", "m"), [(240, 108), (24, 48)])
def test_cells_are_the_transform_of_the_sent_grid_times_the_number_of_transmitters(
    taking_turns, mimo, array, n, m
):
    # In the smaller map the gate holds all bins up to where it repeats.
    scenario, all_at_once = (
        taking_turns(one, array, n_subcarriers=n, n_symbols=m) for one in (mimo, "ideal")
    )
    simulator, positions = Simulator(scenario), array.positions
    full, n_tx = resource_grid(all_at_once, positions), array.tx_shape[0] * array.tx_shape[1]
    tx = [(array.tx_spacing * i, array.tx_spacing * j) for i, j in np.ndindex(array.tx_shape)]
    sent = np.zeros_like(full)
    for element, place in enumerate(positions.tolist()):
        receivers = [(place[0] - i, place[1] - j) for i, j in tx]
        can = [0 <= i < array.rx_shape[0] and 0 <= j < array.rx_shape[1] for i, j in receivers]
        turn = slice(can.index(True), None, n_tx)
        part = (turn, slice(None)) if mimo == "comb" else (slice(None), turn)
        sent[(*part, element)] = full[(*part, element)]
    np.testing.assert_array_equal(resource_grid(scenario, positions), sent)
    part = resource_grid(scenario, positions[1:3], slice(5, 9))
    np.testing.assert_allclose(part, sent[5:9, :, 1:3], atol=1e-12)
    expected = n_tx * cells_in_gate(sent, simulator.gate)
    found = clean_echo(scenario, simulator.gate).reshape(expected.shape)
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())
    # So does noise that the signal carries.
    noisy = dataclasses.replace(scenario, system=dataclasses.replace(scenario.system, noise="transmitter"))
    factor = 1 + scenario.scatterers.total_amplitude * transmitted_noise(noisy, 0, 0)
    expected = n_tx * cells_in_gate(sent * factor[:, :, None], simulator.gate)
    found = Simulator(noisy).observe(0.0).cells.reshape(expected.shape)
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())


def test_an_element_belongs_to_the_first_transmitter_that_gives_it():
    p, q = np.indices((16, 16))
    np.testing.assert_array_equal(VirtualArray().transmitters, (p // 8 * 2 + q // 8).ravel())
    # Elements 0 and 1 of the first transmitter, 1 and 2 of the second: the first has 1.
    assert VirtualArray((2, 1), (2, 1), 1, 1).transmitters.tolist() == [0, 0, 1]


@MODES
def test_echoes_keep_their_peaks_and_noise_is_as_many_times_stronger_as_there_are_transmitters(
    taking_turns, mimo
):
    ideal, scenario = taking_turns("ideal"), taking_turns(mimo)
    simulators = Simulator(ideal), Simulator(scenario)
    peaks = [np.abs(simulator.clean).max() for simulator in simulators]
    assert peaks[1] == pytest.approx(peaks[0], rel=1e-2)
    powers = [simulator.noise_power(10.0) for simulator in simulators]
    assert powers[1] == pytest.approx(4 * powers[0])
    noise = [simulator.observe(10.0).cells - simulator.clean for simulator in simulators]
    np.testing.assert_allclose(noise[1], 2 * noise[0], atol=1e-9)
    assert gain_db(ideal) - gain_db(scenario) == pytest.approx(10 * np.log10(4))
    np.testing.assert_allclose(scene_bound(scenario, 10.0), 2 * scene_bound(ideal, 10.0))


@MODES
def test_noise_of_the_resource_elements_that_are_read_is_white_in_the_gate(taking_turns, mimo):
    scenario = taking_turns(mimo)
    n, m, _ = scenario.array.shares[3]
    weight = np.zeros((240, 112))
    weight[n, m] = scenario.array.n_turns
    covariance = noise_covariance(weight)
    period = (60, 112) if mimo == "comb" else (240, 28)
    assert covariance[0, 0] == pytest.approx(4)
    covariance[0, 0] = 0
    assert np.abs(covariance[: period[0], : period[1]]).max() < 1e-12
    assert all(np.less_equal(Simulator(scenario).gate.shape, period))


@MODES
def test_maps_repeat_up_to_the_phases_of_the_transmitters(taking_turns, mimo):
    scenario = taking_turns(mimo)
    gate = Simulator(scenario).gate
    name, n_bins, sign = ("range_bins", 240 // 4, 1) if mimo == "comb" else ("doppler_bins", 112 // 4, -1)
    farther = dataclasses.replace(gate, **{name: getattr(gate, name) + n_bins})
    phases = np.exp(sign * 2j * np.pi * scenario.array.transmitters.reshape(4, 4) / 4)
    cells = clean_echo(scenario, gate)
    np.testing.assert_allclose(clean_echo(scenario, farther), cells * phases, atol=1e-9 * np.abs(cells).max())


def test_a_mover_turns_from_one_transmitter_to_the_next_as_far_as_it_is_off_its_bin(taking_turns):
    lone = {"xyz": [[5.1, 6.7, 1.9]], "velocity": [3.7], "amplitude": [1.0]}
    scenario, ideal = taking_turns("tdm", **lone), taking_turns("ideal", **lone)
    gate = Simulator(scenario).gate
    place = 3.7 / scenario.system.velocity_bin_mps
    cells, steering = clean_echo(scenario, gate), resource_grid(ideal, scenario.array.positions)[0, 0]
    turned = (cells / (steering / steering[0]).reshape(4, 4))[:, :, ::2, ::2].reshape(*gate.shape, 4)
    expected = np.exp(2j * np.pi * (place - gate.doppler_bins)[:, None] * np.arange(4) / 112)
    np.testing.assert_allclose(turned / turned[..., :1], np.broadcast_to(expected, turned.shape), atol=1e-9)


def test_regions_beyond_what_turns_leave_unambiguous_are_refused(taking_turns):
    street = load_scenario("street")

    def turn(mimo, **changes):
        changed = dataclasses.replace(street, **changes)
        return dataclasses.replace(changed, array=VirtualArray(mimo=mimo))

    far = dataclasses.replace(street.region, y_m=(-60.0, 20.0))
    fast = dataclasses.replace(street.region, speed_mps=(-52.0, 15.0))
    for refused, message in (
        (lambda: turn("comb", region=far), r"at most 156\.1 m, which is c .*4 transmitters .* mimo = 'comb'"),
        (lambda: turn("tdm", region=fast), r"at most 51\.4 m/s for 4 transmitters with mimo = 'tdm'"),
        (lambda: taking_turns("comb", n_subcarriers=241), "n_subcarriers = 241: allowed is a multiple for 4"),
        (lambda: taking_turns("tdm", n_symbols=49), "n_symbols = 49: allowed is a multiple for 4 transm"),
        (lambda: VirtualArray(mimo="fdm"), "array.mimo = 'fdm': allowed is ideal, comb and tdm"),
    ):
        with pytest.raises(InputError, match=message):
            refused()
    assert turn("tdm", region=far).region is far
    assert turn("comb", region=fast).region is fast


@MODES
def test_what_does_not_model_turns_refuses_them(taking_turns, mimo):
    scenario = taking_turns(mimo)
    for refused, task in (
        (lambda: observe(scenario, 10.0, sensing="prs"), "the PRS alone and unequal symbols"),
        (lambda: LinkKind().tasks(load_suite("link"), {"few": scenario}), "a suite of the kind link"),
        (lambda: FrameSimulator(scenario, 10.0), "a simulated frame"),
        (lambda: observe_cube(np.zeros((240, 112, 4, 4), np.complex64), scenario), "a recorded frame"),
        (lambda: image_cost(scenario, get_estimator("fft4d")), "a recorded frame"),
    ):
        with pytest.raises(InputError, match=rf"^\[array\] mimo = '{mimo}': allowed is 'ideal' for {task}$"):
            refused()


def test_turns_are_part_of_the_identity_and_a_parameter_of_families(taking_turns):
    assert len({scenario_digest(taking_turns(mimo)) for mimo in ("ideal", "comb", "tdm")}) == 3
    town, turning = load_scenario("town[seed=101]"), load_scenario("town[seed=101,mimo=tdm]")
    assert (turning.name, turning.array.mimo) == ("town[seed=101,mimo=tdm]", "tdm")
    np.testing.assert_array_equal(turning.scatterers.xyz, town.scatterers.xyz)
