import numpy as np
import pytest
from scipy.constants import speed_of_light

from isacbench.errors import InputError
from isacbench.link.waveform.figures_of_merit import (
    draw_papr_db,
    symbol_papr_db,
    waveform_merits,
    without_suffix,
)
from isacbench.link.waveform.resource_grid import draw_grid
from isacbench.model.numerology import System

SMALL = System(n_subcarriers=64, n_symbols=28)


def test_the_frame_of_the_paper_has_the_times_and_ranges_of_its_table():
    merits = waveform_merits(System())
    assert merits.sampling_rate_hz == pytest.approx(491.52e6)
    assert merits.frame_duration_s == pytest.approx(224 * 1.25 / 240e3)
    assert merits.prefix_s * merits.sampling_rate_hz == pytest.approx(merits.layout.n_prefix)
    assert merits.suffix_s * merits.sampling_rate_hz == pytest.approx(merits.layout.n_suffix)
    undisturbed_s = merits.prefix_s - merits.suffix_s
    assert merits.isi_free_range_m == pytest.approx(speed_of_light * undisturbed_s / 2)
    assert merits.prs_share == pytest.approx(3 / 56)


def test_levels_beside_the_band_fall_and_are_lower_with_the_suffix():
    merits = waveform_merits(SMALL)
    assert (np.diff(merits.out_of_band_db) < 0).all()
    assert (np.diff(merits.plain_out_of_band_db) < 0).all()
    assert (np.array(merits.out_of_band_db) < merits.plain_out_of_band_db).all()
    plain = waveform_merits(without_suffix(SMALL))
    assert plain.out_of_band_db == plain.plain_out_of_band_db == merits.plain_out_of_band_db


def test_ratios_are_those_of_the_grids_frame_by_frame():
    calls = []
    found = draw_papr_db(SMALL, "64qam", 2, seed=3, drawn=lambda: calls.append(1))
    expected = [symbol_papr_db(draw_grid(SMALL, "64qam", trial=trial, seed=3).symbols) for trial in range(2)]
    np.testing.assert_array_equal(found, np.concatenate(expected))
    assert len(calls) == 2


def test_no_frame_is_refused():
    with pytest.raises(InputError, match="n_frames"):
        draw_papr_db(SMALL, "qpsk", 0)
