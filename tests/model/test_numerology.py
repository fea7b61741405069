"""Derived quantities of the numerology, against the figures of the paper's Table I."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.model.numerology import SPEED_OF_LIGHT_MPS, System

SYSTEMS = st.builds(
    System,
    carrier_hz=st.floats(1e9, 300e9),
    subcarrier_spacing_hz=st.floats(15e3, 960e3),
    n_subcarriers=st.integers(1, 4096),
    n_symbols=st.integers(1, 512),
    cyclic_prefix_ratio=st.floats(0, 1),
)


@pytest.mark.parametrize(
    ("quantity", "figure", "last_digit"),
    [
        ("bandwidth_hz", 491.52e6, 1e3),
        ("range_bin_m", 0.305, 1e-3),
        ("unambiguous_range_m", 624.6, 0.1),
        ("velocity_bin_mps", 1.835, 1e-3),
        ("unambiguous_speed_mps", 205.6, 0.1),
        ("isi_free_range_m", 136.6, 0.1),
        ("wavelength_m", 4.283e-3, 1e-6),
        ("symbol_time_s", 5.208e-6, 1e-9),
        ("processing_gain", 2048 * 224, 0.5),
    ],
)
def test_the_default_system_has_the_figures_of_table_one(quantity, figure, last_digit):
    assert getattr(System(), quantity) == pytest.approx(figure, abs=last_digit / 2)


def test_the_suffix_takes_of_the_prefix_what_is_free_of_interference_and_adds_no_time():
    without = System(cyclic_suffix_ratio=0.0)
    assert without.isi_free_range_m == pytest.approx(156.1, abs=0.05)
    assert without.velocity_bin_mps == System().velocity_bin_mps


@given(SYSTEMS)
def test_a_bin_turns_the_phase_once_across_band_or_frame_and_the_unambiguous_limits_hold_whole_maps(system):
    delay_s = 2 * system.range_bin_m / SPEED_OF_LIGHT_MPS
    assert delay_s * system.bandwidth_hz == pytest.approx(1)
    doppler_hz = 2 * system.velocity_bin_mps * system.carrier_hz / SPEED_OF_LIGHT_MPS
    assert doppler_hz * system.n_symbols * system.symbol_time_s == pytest.approx(1)
    assert system.unambiguous_range_m == pytest.approx(SPEED_OF_LIGHT_MPS / 2 / system.subcarrier_spacing_hz)
    assert 2 * system.unambiguous_speed_mps == pytest.approx(system.n_symbols * system.velocity_bin_mps)
