"""Bit rates of a frame."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.errors import InputError
from isacbench.link.waveform.resource_grid import draw_grid, frame_rates, hard_decision_capacity
from isacbench.model.numerology import System

MODULATIONS = ("qpsk", "16qam", "64qam", "256qam")


@pytest.mark.parametrize("modulation", MODULATIONS)
def test_a_frame_carries_the_bits_of_its_grid(modulation):
    system = System(n_subcarriers=48)
    rates = frame_rates(system, modulation)
    assert rates.n_data_bits == draw_grid(system, modulation).bits.size
    frame_time_s = 224 * 1.25 / 240e3
    assert rates.bit_rate_bps * frame_time_s == pytest.approx(rates.n_data_bits)


def test_the_prs_takes_a_twentieth_of_the_bits_and_the_prefix_a_fifth_of_the_time():
    rates = frame_rates(System(), "qpsk")
    # Of critical sampling, a symbol of two bits a sample.
    share = rates.bit_rate_bps / (2 * 491.52e6)
    assert share == pytest.approx((1 - 48 * 512 / (224 * 2048)) / 1.25)


@given(ber=st.floats(0, 1))
def test_the_capacity_of_decided_bits_is_symmetric_and_between_nothing_and_all(ber):
    capacity = float(hard_decision_capacity(ber))
    assert -1e-15 <= capacity <= 1
    assert capacity == pytest.approx(float(hard_decision_capacity(1 - ber)), abs=1e-12)
    # 1 - H2(p) lies between (1 - 2p)²/(2 ln 2) and (1 - 2p)².
    distance = (1 - 2 * ber) ** 2
    assert distance / (2 * np.log(2)) - 1e-12 <= capacity <= distance + 1e-12


def test_what_a_code_could_reach_is_the_capacity_of_the_decided_bits():
    rates = frame_rates(System(), "16qam")
    shares = rates.achievable_rate_bps([0.0, 0.5, 1.0]) / rates.bit_rate_bps
    np.testing.assert_allclose(shares, [1, 0, 1], atol=1e-14)
    assert 0.49 < rates.achievable_rate_bps(0.11) / rates.bit_rate_bps < 0.51


@pytest.mark.parametrize("ber", [-0.1, 1.1, float("nan")])
def test_what_is_no_rate_of_errors_is_refused(ber):
    with pytest.raises(InputError, match="ber holds"):
        hard_decision_capacity(ber)
