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
@pytest.mark.parametrize("length", [0, 1, 27, 28, 30, 31, 32, 200])
def test_bits_are_those_of_the_printed_recursions(c_init, length):
    assert gold_sequence(c_init, length).tolist() == as_printed(c_init, length)


@few
@given(C_INITS, st.integers(1, 300))
def test_py3gpp_has_the_same_bits(c_init, length):
    np.testing.assert_array_equal(gold_sequence(c_init, length), nrPRBS(c_init, length))


@pytest.mark.parametrize("c_init", [-1, 2**31, 0.0, True])
def test_an_initial_value_of_more_than_31_bits_is_an_error(c_init):
    with pytest.raises(InputError, match=r"^c_init = .*: allowed is a whole number from 0 to 2147483647$"):
        gold_sequence(c_init, 8)


@pytest.mark.parametrize("length", [-1, 2.0, True])
def test_a_length_that_counts_nothing_is_an_error(length):
    with pytest.raises(InputError, match=r"^length = .*: allowed is a whole number from 0 to 2147483648$"):
        gold_sequence(1, length)
