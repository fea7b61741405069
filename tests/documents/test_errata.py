"""One test a row of the errata table: what the paper prints is wrong as said, and what is done instead."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from isacbench_algorithms.detectors import CaCfar, OscaCfar
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.music2d import Music2d

from isacbench.bench.suites.suite_kinds import load_suite
from isacbench.dsp.angles.line_subspaces import music_null_spectrum, real_steering, smoothed_covariance
from isacbench.dsp.angles.model_order import eigenvalue_cfar_order, noise_order
from isacbench.dsp.cfar.factors import ca_factor, ca_rate, osca_factor, osca_rate, paper_factor
from isacbench.link.waveform.ofdm import layout
from isacbench.model.array import VirtualArray, rectangular_positions
from isacbench.model.cloud import PointCloud
from isacbench.model.echo import Simulator, echo_parameters, resource_grid
from isacbench.model.frame import PanelFrame, PaperFrame
from isacbench.model.kernels import dirichlet, steering
from isacbench.model.numerology import System
from isacbench.model.prs import prs_elements
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers, Scenario
from isacbench.model.scenes.scenario import load_scenario
from isacbench.plugins.registry import build_estimator
from isacbench.plugins.scoring import score
from tests.single_scores import paper_scores

DOCS = Path(__file__).parents[2] / "docs"
BASE_M = np.array([0.0, 100.0, 0.0])
SYSTEM = System(n_subcarriers=256, n_symbols=64, coherent_phase=False)


def scene(range_bin, doppler_bin, u, w, amplitude):
    """Scenario of scatterers given as a panel of 16 x 16 elements sees them."""
    frame = PanelFrame()
    return Scenario(
        name="few",
        system=SYSTEM,
        array=VirtualArray(),
        frame=frame,
        base_station_m=BASE_M,
        region=Region((-40.0, 40.0), (30.0, 70.0), (-40.0, 40.0), (-25.0, 25.0)),
        scatterers=Scatterers(
            BASE_M + frame.offsets(np.array(range_bin) * SYSTEM.range_bin_m, u, w),
            np.array(doppler_bin) * SYSTEM.velocity_bin_mps,
            np.array(amplitude),
        ),
    )


def direction(theta_deg, phi_deg):
    """Offset of a scatterer one metre away, by azimuth and angle from straight down."""
    theta, phi = np.deg2rad([theta_deg, phi_deg])
    return np.array([[np.sin(phi) * np.cos(theta), -np.sin(phi) * np.sin(theta), -np.cos(phi)]])


def test_sign_of_the_array():
    # Elements that lie further towards u = +1 have shorter paths.
    u, places = 0.3, np.arange(4)
    path_m = -u * places * SYSTEM.wavelength_m / 2
    by_path_lengths = np.exp(-2j * np.pi * path_m / SYSTEM.wavelength_m)
    np.testing.assert_allclose(steering(4, [u])[0], by_path_lengths.conj(), atol=1e-12)
    np.testing.assert_allclose(steering(4, [u])[0], by_path_lengths[::-1] / by_path_lengths[-1], atol=1e-12)


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


def test_osca_order():
    ranks = np.arange(1.0, 10.0)
    noise = OscaCfar(training=(4, 0)).detect(np.tile(ranks[:, None], (1, 3))).noise
    np.testing.assert_array_equal(noise[4], 6.0)
    assert np.percentile(ranks, 75) == 7.0


@pytest.mark.parametrize("frame", [PanelFrame(), PaperFrame()])
@pytest.mark.parametrize("theta_deg", [20.0, 60.0, 85.0])
def test_quadrant_table(frame, theta_deg):
    cosines = [frame.direction_cosines(direction(theta, 70.0)) for theta in (theta_deg, 180 - theta_deg)]
    (u, w), (mirrored_u, mirrored_w) = cosines
    # The printed signs flip beyond 90 degrees: the array would see the same twice.
    np.testing.assert_allclose(np.abs(u), np.abs(mirrored_u), atol=1e-12)
    np.testing.assert_allclose(w, mirrored_w, atol=1e-12)
    assert np.abs(steering(16, u) - steering(16, mirrored_u)).max() > 0.5
    for (u, w), theta in zip(cosines, (theta_deg, 180 - theta_deg), strict=True):
        np.testing.assert_allclose(frame.offsets([1.0], u, w), direction(theta, 70.0), atol=1e-12)


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


def test_first_entry_of_the_phase_ramps():
    scenario = scene([24.7], [1.3], [0.2], [-0.1], [3.0])
    # Printed as 0 it would blank the first subcarrier and the first symbol.
    grid = resource_grid(scenario, [(0, 0)])[:, :, 0]
    np.testing.assert_allclose(grid[0, 0], 3.0)
    np.testing.assert_allclose(np.abs(grid), 3.0)
    np.testing.assert_array_equal(steering(16, [0.3, -0.7])[:, 0], 1)


def test_bins():
    places = np.linspace(20, 30, 1001)[:-1] + 0.005
    strongest = np.abs(dirichlet(np.arange(64), places, 64)).argmax(axis=0)
    nearest = np.rint(places)
    np.testing.assert_array_equal(strongest, nearest)
    assert np.mean(places - np.floor(places)) == pytest.approx(0.5, abs=1e-3)
    assert np.mean(places - nearest) == pytest.approx(0, abs=1e-3)
    # Between the bins, estimators go on to the place itself.
    scenario = scene([24.8], [1.7], [0.1], [0.1], [1.0])
    for estimator in (Music2d(), Fft4d()):
        cloud = estimator.estimate(Simulator(scenario).observe(20.0))
        range_bin = np.linalg.norm(cloud.xyz - BASE_M, axis=1) / SYSTEM.range_bin_m
        assert range_bin == pytest.approx([24.8], abs=0.03)
        assert cloud.velocity / SYSTEM.velocity_bin_mps == pytest.approx([1.7], abs=0.03)


def test_snr():
    simulator = Simulator(scene([24, 24], [0, 0], [0.1, 0.1], [0.1, 0.1], [1.0, 2.0]))
    assert simulator.noise_power(10.0) == pytest.approx((1 + 4) / 10)
    assert simulator.noise_power(10.0) != pytest.approx(abs(1 + 2) ** 2 / 10)
    noise = simulator.observe(10.0).cells - simulator.clean
    assert np.mean(np.abs(noise) ** 2) == pytest.approx(0.5, rel=0.01)


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


def test_prs_symbols_and_comb_offsets():
    of_slot = prs_elements(System())[:, :14]
    symbols = np.flatnonzero(of_slot.any(axis=0))
    np.testing.assert_array_equal(symbols + 1, np.arange(2, 14))
    offsets = np.array([0, 2, 1, 3])
    np.testing.assert_array_equal(of_slot.argmax(axis=0)[symbols], np.tile(offsets, 3))
    # Counted from the start of the frame, a burst would begin in the middle of the offsets.
    assert offsets[symbols % 4][:4].tolist() == [2, 1, 3, 0]


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


@pytest.mark.parametrize(("mimo", "range_m", "speed_mps"), [("comb", 156.1, 205.6), ("tdm", 624.6, 51.4)])
def test_four_transmitters_at_once(mimo, range_m, speed_mps):
    street = load_scenario("street")
    honest = dataclasses.replace(street, array=VirtualArray(mimo=mimo))
    every_n, every_m = honest.array.thinning
    assert street.system.unambiguous_range_m / every_n == pytest.approx(range_m, abs=0.05)
    assert street.system.unambiguous_speed_mps / every_m == pytest.approx(speed_mps, abs=0.05)
    ideal, turns = Simulator(street), Simulator(honest)
    for estimator in (Music2d(), Fft4d()):

        def recall(simulator, snr_db, estimator=estimator):
            cloud = estimator.estimate(simulator.observe(snr_db))
            return score(street.truth, cloud, region=street.region)["recall"]

        # The loss is one of 6 dB, no more.
        assert recall(turns, -35.0) < recall(ideal, -35.0) - 0.05
        assert recall(turns, -35.0 + 10 * np.log10(4)) == pytest.approx(recall(ideal, -35.0), abs=0.05)
        assert recall(turns, 10.0) == pytest.approx(recall(ideal, 10.0), abs=0.05)


def test_peaks_of_all_elements():
    united = 1 - (1 - 1e-3) ** 256
    assert united == pytest.approx(0.226, abs=1e-3)
    printed = osca_rate(paper_factor(1e-3, 9), ((6, 9),) * 8 + ((6, 8),))
    assert 1 - (1 - printed) ** 256 == pytest.approx(1)
    noise = Simulator(scene([24], [1], [0.1], [0.1], [1.0])).observe(-80.0)
    rates = {"element": (1e-3, 2e-3), "noncoherent": (1e-3, 2e-3), "binary": (united, 0.04)}
    for integration, (rate, off) in rates.items():
        estimator = Music2d(detector=CaCfar(), integration=integration, detection_window="rect")
        assert estimator.diagnose(noise).detection.mask.mean() == pytest.approx(rate, abs=off)


def test_eigenvalue_cfar():
    eigenvalues = np.array([[100.0, 90, 80, 70, 1, 1, 1, 1]])
    assert eigenvalue_cfar_order(eigenvalues, 1e-3).tolist() == [1]
    assert noise_order(eigenvalues, 4.0).tolist() == [4]
    assert Music2d().model_order == "noise"
    scenario = scene([24.0], [1.0], [0.1], [0.1], [1.0])
    assert len(Music2d(model_order="eigenvalue_cfar").estimate(Simulator(scenario).observe(20.0))) == 1


def test_row_times_column_spectrum():
    u, w = np.array([-0.4, 0.0, 0.35]), np.array([0.05, -0.4, 0.4])
    scenario = scene([24.0] * 3, [1.0] * 3, u, w, [1.0, 0.9, 1.1])
    simulator = Simulator(scenario)
    gate = simulator.gate
    cell = simulator.clean[24 - gate.range_bins[0], 1 - gate.doppler_bins[0]]
    grid = np.linspace(-0.6, 0.6, 301)
    logs = []
    for lines in (cell, cell.T):
        vectors = np.linalg.eigh(smoothed_covariance(lines[None], 10))[1][:, :, ::-1]
        logs.append(-np.log(music_null_spectrum(vectors, np.array([3]), real_steering(10, grid))[0] + 1e-9))
    product = logs[0][:, None] + logs[1][None, :]
    inner = product[1:-1, 1:-1]
    around = [product[1 + i : 300 + i, 1 + j : 300 + j] for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
    peaks = (inner > np.max(around, axis=0)) & (inner > 2 * np.log(3.0))
    assert peaks.sum() == 9
    cloud = Music2d().estimate(simulator.observe(20.0))
    assert len(cloud) == 3
    np.testing.assert_allclose(np.sort(cloud.xyz[:, 0]), scenario.scatterers.xyz[:, 0], atol=0.5)


def test_points_of_the_image():
    # Half a bin between the cells, so that both of them show it in either dimension.
    scenario = scene([18.5, 26.5], [1.0, -3.0], [0.1, 0.1], [0.1, 0.2], [1.0, 1.0])
    observation = Simulator(scenario).observe(20.0)

    class AsPrinted(Music2d):
        def own_cell_test(self, located):
            return located

        def sidelobe_test(self, located, rdm, levels):
            return located.scatterers

    assert len(AsPrinted().estimate(observation)) > 2
    assert len(Music2d().estimate(observation)) == 2


def test_the_paper_as_printed():
    suite = load_suite("printed")
    printed = build_estimator(suite.estimators[0])
    assert (printed.name, printed.detector) == ("music2d", OscaCfar(threshold="paper"))
    choices = printed.pairing, printed.integration, printed.model_order, printed.largest_direction_error
    assert choices == ("product", "element", "eigenvalue_cfar", None)
    assert {printed.range_window, printed.doppler_window, printed.detection_window} == {"rect"}
    for document in ("errata", "estimators"):
        text = (DOCS / f"{document}.md").read_text(encoding="utf-8")
        assert suite.estimators[0] in re.sub(r",\s+", ",", text)
    # A third of the map passes the printed test in noise; of that no point is left.
    noise = Simulator(scene([24], [1], [0.1], [0.1], [1.0])).observe(-60.0)
    assert printed.diagnose(noise).detection.mask.mean() == pytest.approx(0.32, abs=0.05)
    assert len(printed.estimate(noise)) == 0
    seen = Simulator(scene([24], [1], [0.1], [0.1], [1.0])).observe(20.0)
    assert len(printed.estimate(seen)) >= 1


def test_velocity_nmse():
    static = PointCloud([[0, 0, 0], [1, 1, 1]], [0, 0], [1, 1])
    bin_mps = 1.5
    off = PointCloud(static.xyz, [bin_mps, 0], [1, 1])
    assert paper_scores(static, static, velocity_bin_mps=bin_mps).velocity_nmse == 0
    assert paper_scores(static, off, velocity_bin_mps=bin_mps).velocity_nmse == pytest.approx(0.5)
    missed = off.select(np.array([0]))
    assert paper_scores(static, missed, velocity_bin_mps=bin_mps).velocity_nmse == pytest.approx(1)
    assert paper_scores(static, PointCloud.empty(), velocity_bin_mps=bin_mps).velocity_nmse == 1


@pytest.mark.parametrize("detector", [CaCfar(), OscaCfar(), OscaCfar(order_axis=1)])
def test_detection_without_constants(detector):
    power = np.random.default_rng(0).standard_exponential((40, 30)) * 1e4
    power[20, 15] = 1e6
    found = detector.detect(power)
    assert found.mask[20, 15]
    for scale in (2.0**-30, 2.0**30):
        other = detector.detect(scale * power)
        np.testing.assert_array_equal(other.mask, found.mask)
        np.testing.assert_allclose(other.threshold, scale * found.threshold, rtol=1e-12)
        # An absolute offset decides by the unit alone.
        assert (scale * power > other.threshold + 60000).any() == (scale > 1)


@pytest.mark.slow
def test_which_method_wins():
    scenario = load_scenario("street")
    simulator, bin_mps = Simulator(scenario), scenario.system.velocity_bin_mps
    for snr_db in (-10.0, 0.0, 10.0, 20.0):
        differences = []
        for trial in range(5):
            observation = simulator.observe(snr_db, trial)
            music, fft = (
                paper_scores(
                    scenario.truth, estimator.estimate(observation), scenario.region, bin_mps
                ).deviation
                for estimator in (Music2d(), Fft4d())
            )
            differences.append(music - fft)
        assert np.mean(differences) <= 0


def test_published_metric():
    truth = PointCloud([[0, 0, 0], [10, 0, 0]], [2, -2], [1, 1])
    estimate = PointCloud([[3, 4, 0], [10, 0, 5]], [1, -2], [1, 1])
    published, ours = score(truth, estimate, metric="repository"), score(truth, estimate)
    # x: 3, y: 4, (x, z): 5; the deviation of each velocity pair is half its distance.
    assert published["position"] == pytest.approx(3 + 4 + 5)
    assert published["velocity"] == pytest.approx((0.5 + 0) / 2)
    assert published["deviation"] == pytest.approx(12.25)
    assert ours["deviation"] == pytest.approx(5 + 5 + 5 + 1 / 8)
