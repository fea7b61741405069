"""Rows of the errata table that no other test holds: what is wrong, and what is done.

The other rows are tested where their topic is: arrays, frames, bins, SNR, PRS and transmitters that take
turns in `tests/model`, factors, orders and pairs of directions in `tests/dsp`, points of images in
`tests/algorithms`, velocities and the published metric in `tests/metrics`.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from isacbench_algorithms.detectors import CaCfar, OscaCfar

from isacbench.bench.suites.suite_kinds import load_suite
from isacbench.dsp.cfar.factors import ca_factor, ca_rate, osca_factor, osca_rate, paper_factor
from isacbench.link.waveform.ofdm import layout
from isacbench.model.array import VirtualArray, rectangular_positions
from isacbench.model.echo import Simulator, echo_parameters
from isacbench.model.frame import PanelFrame, PaperFrame
from isacbench.model.kernels import steering
from isacbench.model.numerology import System
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers
from isacbench.model.scenes.scenario import load_scenario
from isacbench.plugins.registry import build_estimator
from isacbench.plugins.scoring import score
from tests.algorithms.scenes import EMPTY
from tests.documents.sources import ROOT

BASE_M = np.array([0.0, 100.0, 0.0])
SYSTEM = System(n_subcarriers=256, n_symbols=64, coherent_phase=False)


def scene(range_bin, doppler_bin, u, w, amplitude):
    """Scenario of scatterers given as a panel of 16 x 16 elements sees them."""
    xyz = BASE_M + EMPTY.frame.offsets(np.array(range_bin) * SYSTEM.range_bin_m, u, w)
    scatterers = Scatterers(xyz, np.array(doppler_bin) * SYSTEM.velocity_bin_mps, np.array(amplitude))
    region = Region((-40.0, 40.0), (30.0, 70.0), (-40.0, 40.0), (-25.0, 25.0))
    return replace(
        EMPTY,
        system=SYSTEM,
        array=VirtualArray(),
        base_station_m=BASE_M,
        region=region,
        scatterers=scatterers,
    )


def direction(theta_deg, phi_deg):
    """Offset of a scatterer one metre away, by azimuth and angle from straight down."""
    theta, phi = np.deg2rad([theta_deg, phi_deg])
    return np.array([[np.sin(phi) * np.cos(theta), -np.sin(phi) * np.sin(theta), -np.cos(phi)]])


def test_threshold_factor():
    osca = ((6, 9),) * 9
    assert osca_rate(paper_factor(1e-3, 9), osca) == pytest.approx(0.32, abs=0.01)
    assert ca_rate(paper_factor(1e-3, 72), 72) == pytest.approx(0.90, abs=0.005)
    assert ca_rate(ca_factor(1e-3, 72), 72) == pytest.approx(1e-3)
    assert osca_rate(osca_factor(1e-3, osca), osca) == pytest.approx(1e-3)
    power = np.random.default_rng(0).standard_exponential((60, 60))
    for detector in (CaCfar, OscaCfar):
        assert detector(threshold="paper").detect(power).mask.mean() > 0.25
        assert detector().detect(power).mask.mean() < 5e-3


@pytest.mark.parametrize("theta_deg", [40.0, 75.0, 120.0])
@pytest.mark.parametrize("phi_deg", [50.0, 80.0])
def test_array_frame(theta_deg, phi_deg):
    array, half_m, range_m = VirtualArray(), System().wavelength_m / 2, 1e5
    panel, target_m = PanelFrame(), 1e5 * direction(theta_deg, phi_deg)[0]
    transmit, receive = (
        # Elements are counted against the direction in which u and w grow.
        -half_m * rectangular_positions(shape, spacing) @ panel.axes[:2]
        for shape, spacing in (
            (array.tx_shape, array.tx_spacing),
            (array.rx_shape, array.rx_spacing),
        )
    )
    out_m, back_m = (np.linalg.norm(target_m - places, axis=1) for places in (transmit, receive))
    path_m = out_m[:, None] + back_m[None, :] - 2 * range_m
    measured = np.exp(-2j * np.pi * path_m / (2 * half_m))
    places = (
        rectangular_positions(array.tx_shape, array.tx_spacing)[:, None]
        + rectangular_positions(array.rx_shape, array.rx_spacing)[None]
    )
    errors = []
    for frame in (panel, PaperFrame()):
        u, w = frame.direction_cosines(target_m[None])
        response = np.outer(steering(16, u[0]), steering(16, w[0]))
        errors.append(np.abs(response[places[..., 0], places[..., 1]] - measured).max())
    assert errors[0] < 1e-3
    assert errors[1] > 0.5
    assert type(load_scenario("street").frame) is PanelFrame
    assert type(load_scenario("street-paper").frame) is PaperFrame


def test_snr_of_the_published_program():
    printed = build_estimator(load_suite("printed").estimators[0])
    simulators = {
        noise: Simulator(load_scenario(name))
        for noise, name in (("receiver", "street"), ("transmitter", "street-transmitter-noise"))
    }
    scenario, gate = simulators["receiver"].scenario, simulators["receiver"].gate
    echo = echo_parameters(scenario)
    row = np.rint(echo.range_bin).astype(int) - gate.range_bins[0]
    column = np.rint(echo.doppler_bin).astype(int) - gate.doppler_bins[0]
    own = np.zeros(gate.shape, dtype=bool)
    own[row, column] = True

    def detected(noise, snr_db):
        mask = printed.diagnose(simulators[noise].observe(snr_db)).detection.mask
        return mask[own].mean(), mask[gate.reachable & ~own].mean()

    # Five dB apart, as many own cells are detected; far below, hardly more of them than of others.
    assert detected("transmitter", -25.0)[0] == pytest.approx(detected("receiver", -30.0)[0], abs=0.05)
    assert detected("transmitter", -25.0)[0] < detected("receiver", -25.0)[0] - 0.05
    assert np.subtract(*detected("transmitter", -50.0)) < 0.1
    for estimator in (build_estimator("music2d"), printed):
        nothing, street = (estimator.estimate(simulators[noise].observe(-80.0)) for noise in simulators)
        assert len(nothing) == 0
        assert 0.25 < score(scenario.truth, street, region=scenario.region)["recall"] < 0.55


def test_snr_of_the_three_clouds():
    scenario, estimator = load_scenario("street"), build_estimator("music2d")
    simulator = Simulator(scenario)

    def recall(snr_db):
        cloud = estimator.estimate(simulator.observe(snr_db))
        return score(scenario.truth, cloud, region=scenario.region)["recall"]

    plateau = [recall(snr_db) for snr_db in (-20.0, -5.0, 10.0)]
    shifted = [recall(snr_db - 25.0) for snr_db in (-20.0, -5.0, 10.0)]
    assert max(plateau) - min(plateau) < 0.1
    assert shifted[0] < 0.5 * plateau[0]
    assert shifted[0] + 0.2 < shifted[1] < shifted[2] - 0.1


@pytest.mark.parametrize(("ratio", "samples", "range_m"), [(1 / 32, 64, 136.6), (1.25 / 32, 80, 131.7)])
def test_cyclic_suffix(ratio, samples, range_m):
    system = System(cyclic_suffix_ratio=ratio)
    assert layout(system).n_suffix == samples
    assert system.isi_free_range_m == pytest.approx(range_m, abs=0.05)
    assert System().cyclic_suffix_ratio == 1 / 32


def test_place_of_both_arrays():
    scenario = scene([24.0], [0.0], [0.6], [0.0], [1.0])
    np.testing.assert_allclose(echo_parameters(scenario).range_bin, [24.0])
    # Receivers 0.61 m to the side have another path; a range bin of Table I is half of that.
    moved_m = (np.linalg.norm(scenario.scatterers.xyz - BASE_M - [0.61, 0, 0]) - scenario.range_m[0]) / 2
    assert abs(moved_m) / System().range_bin_m == pytest.approx(0.6, abs=0.02)
    empty = scene([], [], [], [], [])
    assert not Simulator(empty).observe(np.inf).cells.any()


def test_the_paper_as_printed():
    suite = load_suite("printed")
    printed = build_estimator(suite.estimators[0])
    assert (printed.name, printed.detector) == ("music2d", OscaCfar(threshold="paper"))
    choices = printed.pairing, printed.integration, printed.model_order, printed.largest_direction_error
    assert choices == ("product", "element", "eigenvalue_cfar", None)
    assert {printed.range_window, printed.doppler_window, printed.detection_window} == {"rect"}
    for document in ("errata", "estimators"):
        text = (ROOT / "docs" / f"{document}.md").read_text(encoding="utf-8")
        assert suite.estimators[0] in re.sub(r",\s+", ",", text)
    # A third of the map passes the printed test in noise; of that no point is left.
    noise = Simulator(scene([24], [1], [0.1], [0.1], [1.0])).observe(-60.0)
    assert printed.diagnose(noise).detection.mask.mean() == pytest.approx(0.32, abs=0.05)
    assert len(printed.estimate(noise)) == 0
    seen = Simulator(scene([24], [1], [0.1], [0.1], [1.0])).observe(20.0)
    assert len(printed.estimate(seen)) >= 1
