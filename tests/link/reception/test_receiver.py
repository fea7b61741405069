from functools import partial

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import binom

from isacbench.link.reception.channel import Awgn, Paths, TappedDelay, TwoRay, channel_response
from isacbench.link.reception.channel_estimation import prs_estimator
from isacbench.link.reception.receiver import effective_snr_db, expected_ber, receive
from isacbench.link.waveform.qam import awgn_ber, bits_per_symbol, constellation, decide_bits
from isacbench.link.waveform.resource_grid import ResourceGrid, draw_grid
from isacbench.model.echo import random_stream
from isacbench.model.numerology import System, prs_elements
from tests.conftest import refusal

MODULATIONS = ("qpsk", "16qam", "64qam", "256qam")
FRAME = System(n_subcarriers=512)
SMALL = System(n_subcarriers=256)
FAMILY = 0.01
"""Probability that any of a family of counts is outside its interval by chance."""


@pytest.fixture(scope="module")
def small_grids():
    return {modulation: draw_grid(SMALL, modulation) for modulation in MODULATIONS}


def drawn_response(channel, system=SMALL, trial=0):
    """Channel on every resource element, as a reception has it."""
    return channel_response(system, channel.paths(system, random_stream("channel", trial, 0, channel.name)))


def is_likely(n_errors, n_bits, ber, n_family):
    """Whether a count is in the exact two-sided binomial interval, at its share of the family's chance."""
    tail = FAMILY / n_family / 2
    return min(binom.cdf(n_errors, n_bits, ber), binom.sf(n_errors - 1, n_bits, ber)) >= tail


SNRS_DB = {
    "qpsk": (0.0, 3.0, 6.0, 9.0, 12.0),
    "16qam": (3.0, 8.0, 12.0, 16.0, 19.0),
    "64qam": (6.0, 12.0, 18.0, 22.0, 25.0),
    "256qam": (9.0, 18.0, 24.0, 28.0, 31.0),
}


@pytest.mark.parametrize(("modulation", "snrs_db"), SNRS_DB.items())
def test_bit_errors_in_white_noise_are_those_of_the_closed_form(modulation, snrs_db):
    grid = draw_grid(FRAME, modulation)
    for snr_db in snrs_db:
        reception = receive(grid, FRAME, Awgn(), snr_db, knowledge="perfect")
        assert reception.n_bits == grid.bits.size
        ber = float(awgn_ber(modulation, snr_db))
        assert is_likely(reception.n_bit_errors, reception.n_bits, ber, 20)
        assert reception.ber == reception.n_bit_errors / reception.n_bits
        # Of the noise power of n elements the standard deviation is 1/sqrt(n).
        n = reception.n_bits / bits_per_symbol(modulation)
        assert reception.evm == pytest.approx(10 ** (-snr_db / 20), rel=4 / np.sqrt(n) / 2)
        assert reception.evm_db == pytest.approx(-snr_db, abs=0.03)
        assert np.isnan(reception.channel_error_db)


FAR_AND_NEAR = TwoRay(), TwoRay(distance_m=20, polarization="horizontal")
FADED = [
    (("qpsk", "64qam")[(i + j) % 2], channel, snr_db)
    for i, channel in enumerate([*FAR_AND_NEAR, TappedDelay(), TappedDelay("tdl_d", 30e-9)])
    for j, snr_db in enumerate([5.0, 15.0, 25.0])
]


@pytest.mark.parametrize(("modulation", "channel", "snr_db"), FADED)
def test_bit_errors_over_a_known_channel_are_those_of_its_elements(small_grids, modulation, channel, snr_db):
    grid = small_grids[modulation]
    reception = receive(grid, SMALL, channel, snr_db, knowledge="perfect")
    ber = expected_ber(modulation, SMALL, channel, snr_db, knowledge="perfect")
    assert is_likely(reception.n_bit_errors, reception.n_bits, ber, len(FADED))
    response = np.broadcast_to(drawn_response(channel), grid.is_prs.shape)[~grid.is_prs]
    # Errors of weak elements count most: the kurtosis of the mean is that of 1/|H|².
    inverse = 1 / np.abs(response) ** 2
    deviation = np.sqrt(np.sum(inverse**2)) / np.sum(inverse)
    evm = np.sqrt(10 ** (-snr_db / 10) * np.mean(inverse))
    assert reception.evm == pytest.approx(evm, rel=4 * deviation / 2)
    power_db = 10 * np.log10(np.mean(np.abs(response) ** 2))
    assert reception.channel_power_db == pytest.approx(power_db, abs=0.05)


TAPPED = TappedDelay("tdl_e", 40e-9)


def turned_ber(modulation, gain, snr):
    """Bit error rate of symbols times a gain (n,), in white noise of an SNR (n,), point by point."""
    points, n_bits = constellation(modulation), bits_per_symbol(modulation)
    levels = np.unique(points.real.round(12))
    edges = np.concatenate([[-np.inf], (levels[1:] + levels[:-1]) / 2, [np.inf]])
    sigma = np.sqrt(1 / snr / 2)
    wrong_bits = np.zeros(gain.size)
    for point in points:
        sent = decide_bits(point, modulation)
        for j, level in enumerate(levels):
            decided = decide_bits(level * (1 + 1j), modulation)
            for part, middle in enumerate(((gain * point).real, (gain * point).imag)):
                share = ndtr((edges[j + 1] - middle) / sigma) - ndtr((edges[j] - middle) / sigma)
                wrong_bits += share * np.count_nonzero(decided[part::2] != sent[part::2])
    return wrong_bits / points.size / n_bits


@pytest.mark.parametrize(
    ("modulation", "snr_db"), [("qpsk", 4.0), ("qpsk", 8.0), ("16qam", 14.0), ("64qam", 16.0)]
)
def test_the_effective_snr_predicts_what_the_estimate_costs(modulation, snr_db):
    """The mean over estimates, by the exact error rate given each."""
    noise_gain, noise_power = 0.02, 10 ** (-snr_db / 10)
    # Gauss and Hermite's rule: the error of the estimate is Gaussian in either part.
    nodes, weights = np.polynomial.hermite_e.hermegauss(9)
    errors = np.sqrt(noise_gain * noise_power / 2) * (nodes[:, None] + 1j * nodes).ravel()
    shares = np.outer(weights, weights).ravel() / weights.sum() ** 2
    estimate = 1 + errors
    ber = shares @ turned_ber(modulation, 1 / estimate, np.abs(estimate) ** 2 / noise_power)
    known = float(awgn_ber(modulation, snr_db))
    predicted = float(awgn_ber(modulation, effective_snr_db(modulation, snr_db, noise_gain)))
    assert ber > known
    assert predicted - known == pytest.approx(ber - known, rel=0.05)


def test_errors_of_estimates_and_of_symbols_are_those_of_the_noise_gain(small_grids):
    estimator = prs_estimator(SMALL)
    receptions = [receive(small_grids["16qam"], SMALL, Awgn(), 20.0, trial=trial) for trial in range(20)]
    n = 20 * estimator.basis.shape[1]
    error = np.mean([10 ** (reception.channel_error_db / 10) for reception in receptions])
    assert error == pytest.approx(0.01 * estimator.noise_gain, rel=4 / np.sqrt(n))
    evm = np.sqrt(np.mean([reception.evm**2 for reception in receptions]))
    # The estimate adds 1.1 %, ten times what is allowed.
    assert evm == pytest.approx(np.sqrt(0.01 * (1 + estimator.noise_gain)), rel=1.1e-3)


@pytest.mark.parametrize(
    ("modulation", "channel"),
    [
        *(("qpsk", Awgn()), ("16qam", TwoRay()), ("64qam", TappedDelay()), ("256qam", TappedDelay("tdl_c"))),
        *(("256qam", TwoRay()), ("256qam", TAPPED)),
    ],
)
def test_without_noise_no_bit_is_wrong(small_grids, modulation, channel):
    perfect = receive(small_grids[modulation], SMALL, channel, np.inf, knowledge="perfect")
    assert perfect.n_bit_errors == 0
    assert perfect.evm_db < -250
    estimated = receive(small_grids[modulation], SMALL, channel, np.inf)
    assert estimated.n_bit_errors == 0
    assert estimated.channel_error_db < -80


@pytest.mark.parametrize(
    ("modulation", "channel", "snr_db"),
    [("qpsk", TAPPED, 5.0), ("16qam", TappedDelay("tdl_c", 80e-9), 12.0), ("64qam", Awgn(), 16.0)],
)
def test_receptions_have_the_expected_errors_of_their_fades(small_grids, modulation, channel, snr_db):
    grid, trials = small_grids[modulation], range(20)
    counted = sum(receive(grid, SMALL, channel, snr_db, trial=trial).ber for trial in trials)
    expect = partial(expected_ber, modulation, SMALL, channel, snr_db)
    expected, known = (sum(expect(knowledge=one, trial=i) for i in trials) for one in ("prs", "perfect"))
    # Some 100 000 errors and more; what the estimate adds is several times what is allowed.
    assert counted == pytest.approx(expected, rel=0.005)
    assert expected > 1.01 * known


def test_a_walking_user_needs_an_estimate_that_follows_in_time(small_grids):
    channel = TappedDelay("tdl_d", 30e-9, speed_mps=1.5)
    rates = [receive(small_grids["64qam"], SMALL, channel, 40.0, time_order=order).ber for order in (0, 1, 3)]
    assert rates[0] > 0.1
    assert rates[2] < 0.1 * rates[1] < 0.1 * rates[0]


def test_noise_is_scaled_by_the_snr_alone_and_new_in_every_trial(small_grids):
    def evm(snr_db, **which):
        return receive(small_grids["qpsk"], SMALL, Awgn(), snr_db, knowledge="perfect", **which).evm

    assert evm(20.0) == pytest.approx(evm(0.0) / 10, rel=1e-12)
    assert len({evm(0.0), evm(0.0, trial=1), evm(0.0, seed=1)}) == 3
    assert evm(0.0) == evm(0.0)


def test_fades_are_new_in_every_trial_and_the_same_for_all_modulations(small_grids):
    def power_db(modulation, trial):
        return receive(small_grids[modulation], SMALL, TappedDelay(), 10.0, trial=trial).channel_power_db

    assert power_db("qpsk", 0) == power_db("64qam", 0) != power_db("qpsk", 1)


def test_an_element_without_any_signal_costs_half_of_its_bits_and_no_crash():
    """Two rays of equal power cancel on one subcarrier exactly."""
    system = System(n_subcarriers=4, n_symbols=2)
    grid = draw_grid(system, "qpsk")

    class Notch:
        name = "notch"

        def paths(self, system, stream):
            return Paths(gain=[[1.0], [-1.0]], delay_s=[0.0, 0.0], doppler_hz=[0.0, 0.0])

    reception = receive(grid, system, Notch(), np.inf, knowledge="perfect")
    assert reception.evm == pytest.approx(1)
    assert 0 < reception.n_bit_errors < reception.n_bits


def test_a_frame_of_prs_alone_has_no_rate_of_errors():
    system = System(n_subcarriers=4, n_symbols=6)
    grid = draw_grid(system)
    alone = ResourceGrid(grid.symbols, np.ones_like(grid.is_prs), grid.bits[:0], "qpsk")
    reception = receive(alone, system, Awgn(), 10.0, knowledge="perfect")
    assert reception.n_bits == 0
    assert np.isnan(reception.ber)
    assert np.isnan(reception.evm)


def test_what_cannot_be_received_is_refused(small_grids):
    grid, short = small_grids["qpsk"], System(n_subcarriers=64, n_symbols=2)
    for message, given in {
        "snr_db = nan": (grid, SMALL, Awgn(), float("nan")),
        "snr_db = -inf": (grid, SMALL, Awgn(), -float("inf")),
        "grid of shape (256, 224): allowed is (512, 224)": (grid, FRAME, Awgn(), 10.0),
        "n_symbols = 2: the PRS covers": (draw_grid(short), short, Awgn(), 10.0),
        "the closed form allows": (grid, SMALL, TappedDelay("tdl_e"), 10.0),
    }.items():
        assert message in refusal(receive, *given)
    assert "unknown knowledge 'some'" in refusal(receive, grid, SMALL, Awgn(), 10.0, knowledge="some")


# Of one response, and of so many that rates are read from a table.
@pytest.mark.parametrize(
    ("modulation", "speed_mps", "shape"),
    [("qpsk", 0.0, (1024, 224)), ("qpsk", 5.0, (1024, 10)), ("256qam", 5.0, (64, 113))],
)
def test_the_expected_error_rate_is_the_mean_over_all_data_and_nothing_else(modulation, speed_mps, shape):
    """Counts of a frame tell a mean over some symbols from that over all: fades move through the frame."""
    system = System(n_subcarriers=shape[0], n_symbols=shape[1])
    channel = TappedDelay("tdl_a", 53e-9, speed_mps)
    response = np.broadcast_to(drawn_response(channel, system, trial=3), shape)
    with np.errstate(divide="ignore"):
        snr_db = 20.0 + 20 * np.log10(np.abs(response[~prs_elements(system)]))
    expected = expected_ber(modulation, system, channel, 20.0, knowledge="perfect", trial=3)
    assert expected == pytest.approx(float(np.mean(awgn_ber(modulation, snr_db))), rel=1e-7)
