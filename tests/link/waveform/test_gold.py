"""Gold sequences: the recursions of 3GPP TS 38.211, 5.2.1, another implementation, and linearity."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from py3gpp import nrPRBS

from isacbench.errors import InputError
from isacbench.link.waveform.resource_grid import gold_sequence
from tests.conftest import few

C_INITS = st.integers(0, 2**31 - 1)


def as_printed(c_init, length):
    """Bits by the three formulas of the standard, one at a time."""
    n = 1600 + length
    x1 = [1] + 30 * [0]
    x2 = [c_init // 2**i % 2 for i in range(31)]
    for i in range(n - 31):
        x1.append((x1[i + 3] + x1[i]) % 2)
        x2.append((x2[i + 3] + x2[i + 2] + x2[i + 1] + x2[i]) % 2)
    return [(x1[i + 1600] + x2[i + 1600]) % 2 for i in range(length)]


@pytest.mark.parametrize("c_init", [0, 1, 3072, 2**30, 2**31 - 1])
@pytest.mark.parametrize("length", [1, 27, 28, 31, 200])
def test_bits_are_those_of_the_printed_recursions(c_init, length):
    assert gold_sequence(c_init, length).tolist() == as_printed(c_init, length)


@few
@given(C_INITS, st.integers(1, 300))
def test_py3gpp_has_the_same_bits(c_init, length):
    np.testing.assert_array_equal(gold_sequence(c_init, length), nrPRBS(c_init, length))


def test_without_the_second_sequence_the_first_goes_on_from_its_known_state():
    # Implementations of LTE and 5G start the first register here, bits 1569 to 1599, to save so many steps.
    first = [0x54D21B24 >> i & 1 for i in range(31)]
    for i in range(100):
        first.append(first[i + 3] ^ first[i])
    assert gold_sequence(0, 100).tolist() == first[31:]


@given(C_INITS, C_INITS)
def test_sequences_add_as_their_initial_values_do(a, b):
    bits = [gold_sequence(c_init, 100) for c_init in (a, b, a ^ b, 0)]
    np.testing.assert_array_equal(bits[0] ^ bits[1], bits[2] ^ bits[3])


@given(C_INITS)
def test_the_product_of_both_polynomials_annihilates_every_sequence(c_init):
    first = [1, 0, 0, 1] + 27 * [0] + [1]
    second = [1, 1, 1, 1] + 27 * [0] + [1]
    product = np.convolve(first, second) % 2
    bits = gold_sequence(c_init, 300).astype(int)
    assert not (np.correlate(bits, product) % 2).any()


def test_a_longer_sequence_begins_with_the_shorter():
    long = gold_sequence(77, 1000)
    for length in (0, 1, 30, 31, 32, 999):
        np.testing.assert_array_equal(gold_sequence(77, length), long[:length])


def test_bits_are_balanced_and_uncorrelated_with_other_sequences_and_shifts():
    n = 40_000
    # No sparse initial values: after those, recursions of few taps are unbalanced over stretches this short.
    c_init = np.random.default_rng(3).integers(2**31, size=5)
    signs = 1 - 2.0 * np.array([gold_sequence(int(value), n) for value in c_init])
    # Five standard deviations of a sum of fair signs.
    assert np.abs(signs.sum(axis=1)).max() < 5 * np.sqrt(n)
    correlation = signs @ signs.T
    assert np.abs(correlation - n * np.eye(5)).max() < 5 * np.sqrt(n)
    shifted = [signs[3, :-k] @ signs[3, k:] for k in (1, 2, 3, 31, 1600)]
    assert np.abs(shifted).max() < 5 * np.sqrt(n)


@pytest.mark.parametrize("c_init", [-1, 2**31, 0.0, True])
def test_an_initial_value_of_more_than_31_bits_is_an_error(c_init):
    with pytest.raises(InputError, match=r"^c_init = .*: allowed is a whole number from 0 to 2147483647$"):
        gold_sequence(c_init, 8)


@pytest.mark.parametrize("length", [-1, 2.0, True])
def test_a_length_that_counts_nothing_is_an_error(length):
    with pytest.raises(InputError, match=r"^length = .*: allowed is a whole number from 0 to 2147483648$"):
        gold_sequence(1, length)
