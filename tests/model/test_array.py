"""The virtual array as the sum co-array."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.errors import InputError
from isacbench.model.array import VirtualArray, rectangular_positions

SIDES = st.integers(1, 5)


def test_the_default_array_has_sixteen_by_sixteen_elements_half_a_wavelength_apart():
    assert VirtualArray().shape == (16, 16)
    assert VirtualArray().positions.tolist() == [[p, q] for p in range(16) for q in range(16)]


@given(tx=st.tuples(SIDES, SIDES), rx_side=SIDES)
def test_transmitters_one_receive_aperture_apart_multiply_it(tx, rx_side):
    array = VirtualArray(tx_shape=tx, rx_shape=(rx_side, rx_side), tx_spacing=rx_side)
    assert array.shape == (tx[0] * rx_side, tx[1] * rx_side)


@given(tx=st.tuples(SIDES, SIDES), rx=st.tuples(SIDES, SIDES), spacing=st.integers(1, 4))
def test_elements_are_the_distinct_sums_of_transmit_and_receive_positions(tx, rx, spacing):
    sums = {
        (spacing * a + c, spacing * b + d)
        for a in range(tx[0])
        for b in range(tx[1])
        for c in range(rx[0])
        for d in range(rx[1])
    }
    filled = len(sums) == (max(p for p, _ in sums) + 1) * (max(q for _, q in sums) + 1)
    if filled:
        positions = VirtualArray(tx, rx, tx_spacing=spacing).positions
        assert [tuple(place) for place in positions.tolist()] == sorted(sums)
    else:
        with pytest.raises(InputError):
            VirtualArray(tx, rx, tx_spacing=spacing)


def test_an_array_with_holes_is_refused_with_its_shape_and_what_is_allowed():
    with pytest.raises(InputError, match=r"array: .*tx_spacing 9.*fills 256 of 17 x 17.*filled rectangle"):
        VirtualArray(tx_spacing=9)


def test_rectangular_positions_run_row_by_row():
    assert rectangular_positions((2, 3), 4).tolist() == [[0, 0], [0, 4], [0, 8], [4, 0], [4, 4], [4, 8]]


def test_positions_cannot_be_written_to():
    with pytest.raises(ValueError, match="read-only"):
        VirtualArray().positions[0, 0] = 1
    assert VirtualArray().positions.dtype == np.int64
