import numpy as np
import pytest

from isacbench.link.waveform.figures_of_merit import draw_papr_db, waveform_merits, without_suffix
from isacbench.link.waveform.resource_grid import draw_grid
from isacbench.model.numerology import System
from isacbench.report.figures.waveform_figures import (
    draw_papr,
    draw_resource_grid,
    draw_spectrum,
    draw_waveform,
)
from isacbench.report.texts.waveform_merits import describe_waveform, waveform_grids

SYSTEM = System(n_subcarriers=128, n_symbols=56)


@pytest.fixture(scope="module")
def papr_db():
    return {name: draw_papr_db(SYSTEM, name, 2) for name in ("qpsk", "64qam")}


def test_tables_and_json_tell_the_same(papr_db):
    merits = waveform_merits(SYSTEM)
    what, beside, data = waveform_grids(SYSTEM, merits, papr_db)
    described = describe_waveform(SYSTEM, merits, papr_db)
    for grid in (what, beside, data):
        assert all(len(row) == len(grid.header) for row in grid.rows)
    for row, level in zip(beside.rows, described["out_of_band"], strict=True):
        assert row == [
            str(level["offset_spacings"]),
            f"{level['level_db']:.1f}",
            f"{level['without_suffix_db']:.1f}",
        ]
    *rows, theory = data.rows
    for name, *numbers in rows:
        known = described["modulations"][name]
        assert int(numbers[0]) == known["n_data_bits"] == draw_grid(SYSTEM, name).bits.size
        assert numbers[2:] == [f"{known['papr']['median_db']:.2f}", "too few symbols"]
        assert known["papr"] == {"n_symbols": 112, "median_db": np.median(papr_db[name]), "rare_db": None}
    assert theory[3:] == [f"{described['papr_theory'][key]:.2f}" for key in ("median_db", "rare_db")]


@pytest.mark.parametrize(("n_symbols", "n_above"), [(999, None), (1000, 1), (3000, 3), (10080, 10)])
def test_one_symbol_in_a_thousand_exceeds_the_ratio_that_is_told(n_symbols, n_above):
    ratios = np.random.default_rng(0).permutation(n_symbols) / 1000
    described = describe_waveform(SYSTEM, waveform_merits(SYSTEM), {"qpsk": ratios})
    rare_db = described["modulations"]["qpsk"]["papr"]["rare_db"]
    assert rare_db is None if n_above is None else np.sum(ratios > rare_db) == n_above


def curves(axes, style):
    return [line.get_xydata() for line in axes.lines if line.get_linestyle() == style]


def deviation_db(measured, theory, lowest, highest):
    """Root mean square of what was measured over theory, between two places."""
    place, level_db = measured.T
    inside = (place > lowest) & (place < highest)
    return np.sqrt(np.mean((level_db[inside] - np.interp(place[inside], *theory.T)) ** 2))


def test_the_measured_spectrum_is_drawn_over_the_closed_form():
    whole, edge = draw_spectrum("s", SYSTEM, draw_grid(SYSTEM)).axes
    for measured, theory in zip(curves(whole, "-"), curves(whole, "--"), strict=True):
        # About 70 independent bins a point; within the band that sampling folds nothing to speak of into.
        assert deviation_db(measured, theory, 0, SYSTEM.bandwidth_hz / 1e6) < 1
    for measured, theory in zip(curves(edge, "-"), curves(edge, "--"), strict=True):
        # About 9 a point: a third of the power, up or down.
        assert deviation_db(measured, theory, -8, 8) < 2.5
    assert len(curves(whole, "-")) == len(curves(edge, "-")) == 2


def test_a_system_without_a_suffix_has_one_spectrum():
    plain = without_suffix(SYSTEM)
    whole, _ = draw_spectrum("s", plain, draw_grid(plain)).axes
    assert len(curves(whole, "-")) == len(curves(whole, "--")) == 1


def test_every_modulation_falls_from_all_symbols_to_the_last(papr_db):
    (axes,) = draw_papr("s", SYSTEM, papr_db).axes
    for line, ratios in zip(axes.lines, papr_db.values(), strict=False):
        assert line.get_ydata()[0] == 1
        assert line.get_ydata()[-1] == pytest.approx(1 / ratios.size)
        assert line.get_xdata()[-1] == ratios.max()
    assert len(axes.lines) == len(papr_db) + 2


def test_the_grid_is_drawn_as_it_is():
    grid = draw_grid(SYSTEM)
    frame, slot = draw_resource_grid("s", grid).axes
    np.testing.assert_array_equal(slot.images[0].get_array(), grid.is_prs[:16, :14])
    np.testing.assert_array_equal(frame.images[0].get_array()[0], grid.is_prs.any(axis=0))


def test_figures_are_files_and_replace_older_ones(tmp_path, papr_db):
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "papr.png").write_text("older")
    paths = draw_waveform(tmp_path / "new", "a $name$", SYSTEM, draw_grid(SYSTEM), papr_db)
    assert [path.name for path in paths] == ["spectrum.png", "papr.png", "grid.png"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)
    assert len(list((tmp_path / "new").iterdir())) == 3
