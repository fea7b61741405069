"""QAM: the mappings of 3GPP TS 38.211, 5.1.3 to 5.1.6, nearest symbols, and error rates in white noise."""

import itertools
import math
from functools import partial

import numpy as np
import pytest
from py3gpp import nrSymbolModulate
from scipy.special import erfc, log_ndtr

from isacbench.link.sensing.observing import observe
from isacbench.link.waveform.qam import awgn_ber, bits_per_symbol, constellation, decide_bits, modulate_bits
from isacbench.link.waveform.resource_grid import draw_grid, frame_rates
from isacbench.model.numerology import System
from tests.conftest import refusal

BITS = {"qpsk": 2, "16qam": 4, "64qam": 6, "256qam": 8}
MODULATIONS = list(BITS)

each_modulation = pytest.mark.parametrize("modulation", MODULATIONS)


def words(modulation):
    """All words of bits, in ascending order of the numbers that they spell."""
    return np.array(list(itertools.product([0, 1], repeat=BITS[modulation])))


# The mappings.


@each_modulation
@pytest.mark.parametrize("dtype", [bool, np.uint8, np.int8])
def test_words_are_mapped_as_py3gpp_maps_them(modulation, dtype):
    bits = words(modulation).ravel()
    expected = nrSymbolModulate(bits, modulation)
    np.testing.assert_allclose(modulate_bits(bits.astype(dtype), modulation), expected, rtol=4e-16)
    np.testing.assert_allclose(constellation(modulation), expected, rtol=4e-16)


def test_the_constellation_cannot_be_overwritten():
    with pytest.raises(ValueError, match="read-only"):
        constellation("qpsk")[0] = 0
    mapped = modulate_bits([0, 0], "qpsk")
    mapped[0] = 0
    assert constellation("qpsk")[0] != 0


# Decisions.


@each_modulation
def test_decided_is_the_nearest_symbol_on_both_sides_of_every_border(modulation):
    points = constellation(modulation)
    levels = np.unique(points.real.round(12))
    borders = (levels[1:] + levels[:-1]) / 2
    axis = np.concatenate([borders - 1e-9, borders + 1e-9, [-2.0, 2.0]])
    received = (axis[:, None] + 1j * axis).ravel()
    decided = modulate_bits(decide_bits(received, modulation), modulation)
    nearest = np.abs(received[:, None] - points).min(axis=1)
    np.testing.assert_allclose(np.abs(received - decided), nearest, rtol=0, atol=1e-12)


@each_modulation
def test_far_outside_the_outermost_symbol_is_the_nearest(modulation):
    levels = constellation(modulation).real
    outermost = levels.max()
    for size in (3.0, 1e300, math.inf):
        bits = decide_bits(np.array([complex(size, -size), complex(-size, size)]), modulation)
        decided = modulate_bits(bits, modulation)
        np.testing.assert_allclose(decided, [outermost * (1 - 1j), outermost * (-1 + 1j)], rtol=1e-15)


@each_modulation
def test_decisions_invert_the_mapping_of_every_word_row_by_row(modulation):
    bits = words(modulation).ravel()
    symbols = modulate_bits(bits, modulation).reshape(2, -1)
    for array in (symbols, np.asfortranarray(symbols)):
        decided = decide_bits(array, modulation)
        assert decided.dtype == np.uint8
        np.testing.assert_array_equal(decided, bits)
    assert decide_bits(np.empty(0), modulation).shape == (0,)


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


@each_modulation
def test_error_rate_agrees_with_cho_and_yoon(modulation):
    for snr_db in (-30, -3, 0, 7, 15):
        expected = cho_and_yoon(modulation, 10 ** (snr_db / 10))
        assert awgn_ber(modulation, snr_db) == pytest.approx(expected, rel=1e-12)


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
    snr_db = [[-math.inf, -1e5, -400], [400, 1e5, math.inf]]
    expected = [[0.5, 0.5, 0.5], [0, 0, 0]]
    np.testing.assert_allclose(awgn_ber(modulation, snr_db), expected, rtol=1e-12)
    assert awgn_ber(modulation, 3.0).shape == ()


# Mistakes.


def test_an_unknown_modulation_is_an_error():
    for call, *given in (
        *((bits_per_symbol, "16qm"), (constellation, "16qm"), (modulate_bits, [0, 0], "16qm")),
        *((decide_bits, [0], "16qm"), (awgn_ber, "16qm", 0), (frame_rates, System(), "16qm")),
        *((draw_grid, System(), "16qm"), (partial(observe, modulation="16qm"), "single")),
    ):
        assert "unknown modulation '16qm': did you mean '16qam'" in refusal(call, *given)


def test_bits_that_fill_no_symbols_what_is_no_bit_and_nan_are_errors():
    for shape in ((3,), (2, 2), ()):
        message = f"bits of shape {shape}: allowed is one axis of a multiple of 2"
        assert refusal(modulate_bits, np.zeros(shape, dtype=np.uint8), "qpsk") == message
    for bits in ([0, 2], [0, -1], [0.0, 1.0], ["0", "1"]):
        message = f"bits of dtype {np.array(bits).dtype}: allowed are the whole numbers 0 and 1"
        assert refusal(modulate_bits, bits, "qpsk") == message
    message = refusal(decide_bits, [1, complex(0, math.nan), math.nan], "qpsk")
    assert message == "symbols hold 2 NaN: allowed are numbers"
