"""QAM: the mappings of 3GPP TS 38.211, 5.1.3 to 5.1.6, nearest symbols, and error rates in white noise."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial.legendre import leggauss
from py3gpp import nrSymbolModulate
from scipy.special import erfc, log_ndtr

from isacbench.errors import InputError
from isacbench.link.waveform.qam import awgn_ber, bits_per_symbol, constellation, decide_bits, modulate_bits
from tests.conftest import few

BITS = {"qpsk": 2, "16qam": 4, "64qam": 6, "256qam": 8}
MODULATIONS = list(BITS)

each_modulation = pytest.mark.parametrize("modulation", MODULATIONS)


def words(modulation):
    """All words of bits, in ascending order of the numbers that they spell."""
    return np.array(list(itertools.product([0, 1], repeat=BITS[modulation])))


def as_printed(modulation, b):
    """Symbol of one word by the formula of the standard."""
    if modulation == "qpsk":
        return ((1 - 2 * b[0]) + 1j * (1 - 2 * b[1])) / math.sqrt(2)
    if modulation == "16qam":
        real = (1 - 2 * b[0]) * (2 - (1 - 2 * b[2]))
        imag = (1 - 2 * b[1]) * (2 - (1 - 2 * b[3]))
        return (real + 1j * imag) / math.sqrt(10)
    if modulation == "64qam":
        real = (1 - 2 * b[0]) * (4 - (1 - 2 * b[2]) * (2 - (1 - 2 * b[4])))
        imag = (1 - 2 * b[1]) * (4 - (1 - 2 * b[3]) * (2 - (1 - 2 * b[5])))
        return (real + 1j * imag) / math.sqrt(42)
    real = (1 - 2 * b[0]) * (8 - (1 - 2 * b[2]) * (4 - (1 - 2 * b[4]) * (2 - (1 - 2 * b[6]))))
    imag = (1 - 2 * b[1]) * (8 - (1 - 2 * b[3]) * (4 - (1 - 2 * b[5]) * (2 - (1 - 2 * b[7]))))
    return (real + 1j * imag) / math.sqrt(170)


# The mappings.


@each_modulation
def test_symbols_are_those_of_the_printed_formulas(modulation):
    expected = [as_printed(modulation, [int(bit) for bit in word]) for word in words(modulation)]
    np.testing.assert_allclose(constellation(modulation), expected, rtol=4e-16)


@each_modulation
def test_py3gpp_maps_all_words_alike(modulation):
    bits = words(modulation).ravel()
    np.testing.assert_allclose(
        modulate_bits(bits, modulation), nrSymbolModulate(bits, modulation), rtol=4e-16
    )


@each_modulation
def test_symbols_are_a_square_lattice_of_unit_mean_power(modulation):
    points = constellation(modulation)
    assert points.shape == (2 ** BITS[modulation],)
    assert np.mean(np.abs(points) ** 2) == pytest.approx(1, rel=1e-15)
    side = 2 ** (BITS[modulation] // 2)
    lattice = np.arange(1 - side, side, 2) / math.sqrt(2 * (len(points) - 1) / 3)
    np.testing.assert_allclose(np.unique(points.real.round(14)), lattice, atol=1e-14)
    np.testing.assert_allclose(np.unique(points.imag.round(14)), lattice, atol=1e-14)
    assert len(np.unique(points.round(14))) == len(points)


@each_modulation
def test_neighbours_differ_in_one_bit(modulation):
    points, labels = constellation(modulation), words(modulation)
    distance = np.abs(points[:, None] - points)
    nearest = distance[distance > 0].min()
    n_bits_apart = (labels[:, None] != labels).sum(axis=2)
    assert (n_bits_apart[np.isclose(distance, nearest)] == 1).all()


@each_modulation
def test_symbols_follow_one_another_as_their_bits_do(modulation):
    bits = np.random.default_rng(1).integers(0, 2, 12 * BITS[modulation])
    one_by_one = [modulate_bits(word, modulation)[0] for word in bits.reshape(12, -1)]
    np.testing.assert_array_equal(modulate_bits(bits, modulation), one_by_one)
    for dtype in (bool, np.uint8, np.int8):
        np.testing.assert_array_equal(modulate_bits(bits.astype(dtype), modulation), one_by_one)


def test_the_constellation_cannot_be_overwritten():
    with pytest.raises(ValueError, match="read-only"):
        constellation("qpsk")[0] = 0
    mapped = modulate_bits([0, 0], "qpsk")
    mapped[0] = 0
    assert constellation("qpsk")[0] != 0


# Decisions.


@each_modulation
def test_decisions_invert_the_mapping_of_every_word(modulation):
    bits = words(modulation).ravel()
    decided = decide_bits(modulate_bits(bits, modulation), modulation)
    assert decided.dtype == np.uint8
    np.testing.assert_array_equal(decided, bits)


@each_modulation
@few
@given(st.complex_numbers(max_magnitude=2, allow_nan=False))
def test_decided_is_the_nearest_symbol(modulation, received):
    decided = modulate_bits(decide_bits(received, modulation), modulation)[0]
    nearest = min(abs(received - point) for point in constellation(modulation))
    assert abs(received - decided) <= nearest + 1e-14


@each_modulation
def test_far_outside_the_outermost_symbol_is_the_nearest(modulation):
    levels = constellation(modulation).real
    outermost = levels.max()
    for size in (3.0, 1e300, math.inf):
        bits = decide_bits(np.array([complex(size, -size), complex(-size, size)]), modulation)
        np.testing.assert_allclose(
            modulate_bits(bits, modulation), [outermost * (1 - 1j), outermost * (-1 + 1j)], rtol=1e-15
        )


def test_decisions_run_through_an_array_row_by_row():
    symbols = modulate_bits(words("16qam").ravel(), "16qam").reshape(2, 8)
    np.testing.assert_array_equal(decide_bits(symbols, "16qam"), words("16qam").ravel())
    np.testing.assert_array_equal(decide_bits(np.asfortranarray(symbols), "16qam"), words("16qam").ravel())
    assert decide_bits(np.empty(0), "16qam").shape == (0,)


# Error rates.


def cho_and_yoon(modulation, snr):
    """Bit error rate by the paper's expression: mean over the bits k of an axis of a square constellation."""
    side = 2 ** (BITS[modulation] // 2)
    argument = math.sqrt(3 * snr / (2 * (side**2 - 1)))
    per_bit = []
    for k in range(1, BITS[modulation] // 2 + 1):
        terms = []
        for i in range(side - side // 2**k):
            sign = (-1) ** (i * 2 ** (k - 1) // side)
            weight = 2 ** (k - 1) - math.floor(i * 2 ** (k - 1) / side + 0.5)
            terms.append(sign * weight * erfc((2 * i + 1) * argument))
        per_bit.append(sum(terms) / side)
    return sum(per_bit) / len(per_bit)


def integrated(modulation, snr):
    """Bit error rate by quadrature: density of the noise along one axis, times the bits decided wrongly."""
    points = np.unique(constellation(modulation).real.round(15))
    half, sigma = (points[1] - points[0]) / 2, math.sqrt(1 / snr / 2)
    edges = [points[0] - 12 * sigma - half, *(points[:-1] + half), points[-1] + 12 * sigma + half]
    nodes, weights = leggauss(60)
    total = 0.0
    for sent in points:
        truth = decide_bits(sent, modulation)[::2].astype(int)
        for low, high in itertools.pairwise(edges):
            x = (low + high) / 2 + (high - low) / 2 * nodes
            n_wrong = (decide_bits(x, modulation).reshape(len(x), -1)[:, ::2] != truth).sum(axis=1)
            density = np.exp(-(((x - sent) / sigma) ** 2) / 2) / sigma / math.sqrt(2 * math.pi)
            total += (high - low) / 2 * weights @ (density * n_wrong)
    return total / len(points) / (BITS[modulation] / 2)


@each_modulation
def test_error_rate_agrees_with_cho_and_yoon(modulation):
    for snr_db in (-30, -3, 0, 7, 15):
        expected = cho_and_yoon(modulation, 10 ** (snr_db / 10))
        assert awgn_ber(modulation, snr_db) == pytest.approx(expected, rel=1e-12)


@each_modulation
def test_error_rate_is_the_integral_over_wrong_decisions(modulation):
    for snr_db in (-5, 12):
        expected = integrated(modulation, 10 ** (snr_db / 10))
        assert awgn_ber(modulation, snr_db) == pytest.approx(expected, rel=1e-9)


@each_modulation
def test_tails_of_1e_300_keep_their_digits(modulation):
    points = constellation(modulation)
    distance = np.abs(points[:, None] - points)
    nearest = distance[distance > 1e-9].min()
    n_neighbours = np.isclose(distance, nearest).sum() / len(points)
    for q in (25.0, 30.0, 37.0):
        # Nearest neighbours alone: half their distance is q standard deviations of one axis.
        snr_db = 20 * math.log10(q / nearest * math.sqrt(2))
        expected = math.log(n_neighbours / BITS[modulation]) + log_ndtr(-q)
        assert math.log(awgn_ber(modulation, snr_db)) == pytest.approx(expected, rel=1e-12)
    assert awgn_ber(modulation, snr_db) < 1e-299


@each_modulation
def test_error_rate_is_a_half_without_signal_and_nothing_without_noise(modulation):
    snr_db = [-math.inf, -1e5, -400, 400, 1e5, math.inf]
    np.testing.assert_allclose(awgn_ber(modulation, snr_db), [0.5, 0.5, 0.5, 0, 0, 0], rtol=1e-12)


def test_error_rate_grows_with_the_constellation_and_falls_with_the_snr():
    rates = np.array([awgn_ber(modulation, np.arange(0.0, 31.0)) for modulation in MODULATIONS])
    assert (np.diff(rates, axis=0) > 0).all()
    assert (np.diff(rates, axis=1) < 0).all()


def test_error_rates_have_the_shape_of_the_snr():
    assert awgn_ber("64qam", 3.0).shape == ()
    assert awgn_ber("64qam", [[1, 2, 3]]).shape == (1, 3)


def test_decisions_in_noise_err_as_often_as_stated():
    rng = np.random.default_rng(2)
    n_bits, snr_db = 240_000, 12.0
    sent = rng.integers(0, 2, n_bits, dtype=np.uint8)
    for modulation in MODULATIONS:
        symbols = modulate_bits(sent, modulation)
        noise = rng.normal(0, 10 ** (-snr_db / 20) / math.sqrt(2), (len(symbols), 2)).view(np.complex128)[
            :, 0
        ]
        n_wrong = int((decide_bits(symbols + noise, modulation) != sent).sum())
        expected = n_bits * float(awgn_ber(modulation, snr_db))
        # Bits of a symbol share its noise: at most half of them go wrong together.
        deviation = math.sqrt(expected * BITS[modulation] / 2)
        assert abs(n_wrong - expected) < 5 * deviation


# Mistakes.


@pytest.mark.parametrize(
    "call",
    [
        bits_per_symbol,
        constellation,
        lambda name: modulate_bits([0, 0], name),
        lambda name: decide_bits([0], name),
        lambda name: awgn_ber(name, 0),
    ],
)
def test_an_unknown_modulation_is_an_error(call):
    with pytest.raises(InputError, match="unknown modulation '16qm': did you mean '16qam'"):
        call("16qm")


@pytest.mark.parametrize("shape", [(3,), (2, 2), ()])
def test_bits_that_fill_no_symbols_are_an_error(shape):
    with pytest.raises(InputError, match=r"^bits of shape .*: allowed is one axis of a multiple of 2$"):
        modulate_bits(np.zeros(shape, dtype=np.uint8), "qpsk")


@pytest.mark.parametrize("bits", [[0, 2], [0, -1], [0.0, 1.0], ["0", "1"]])
def test_what_is_no_bit_is_an_error(bits):
    with pytest.raises(InputError, match=r"^bits of dtype .*: allowed are the whole numbers 0 and 1$"):
        modulate_bits(bits, "qpsk")


def test_nan_has_no_nearest_symbol():
    with pytest.raises(InputError, match=r"^symbols hold 2 NaN: allowed are numbers$"):
        decide_bits([1, complex(0, math.nan), math.nan], "qpsk")
