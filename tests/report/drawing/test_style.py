import pytest
from matplotlib.lines import Line2D

from isacbench.files.escaping import file_stems
from isacbench.report.figures import drawable, new_figure, styled, velocity_colours


def test_stems_are_safe_short_and_unique_whatever_the_case():
    names = ["street", "Street", "../..", "", "a/b", "a b", "x" * 300, "-" * 99 + "y"]
    stems = list(file_stems(names).values())
    assert stems[:6] == ["street", "Street-2", "unnamed", "unnamed-2", "a-b", "a-b-2"]
    assert all(0 < len(stem) <= 60 for stem in stems)
    assert len({stem.lower() for stem in stems}) == len(names)


def test_names_are_drawn_as_text_never_as_mathematics_or_missing_glyphs():
    assert drawable("$x$ é_a") == r"\$x\$ é_a"
    assert drawable("a\n街") == "a\ufffd\ufffd"


def test_velocity_colours_are_centred_at_zero_and_span_both_directions():
    colours = velocity_colours(15.0)
    assert colours.norm(0.0) == pytest.approx(0.5)
    assert (colours.norm.vmin, colours.norm.vmax) == (-15.0, 15.0)
    assert colours.norm(2.0) - 0.5 > 2 * 2 / 30


def test_a_static_region_has_colours():
    assert velocity_colours(0.0).norm.vmax > 0


@pytest.mark.parametrize("n_labels", [1, 5, 6, 13])
def test_a_legend_takes_as_few_columns_as_its_rows_allow_and_the_figure_grows_by_it(n_labels):
    entries = [Line2D([], [], label="a label of some length") for _ in range(n_labels)]
    for width_in in (4.0, 11.0):
        with styled():
            figure = new_figure(width_in, 3.0, legend=entries)
            figure.draw_without_rendering()
        n_columns = figure.legends[0]._ncols
        n_rows = -(-n_labels // n_columns)
        assert n_columns == 1 or -(-n_labels // (n_columns - 1)) > n_rows
        box = figure.legends[0].get_window_extent()
        assert 0 <= box.x0 < box.x1 <= figure.bbox.width
        assert box.height / figure.dpi < figure.get_figheight() - 3.0 + 0.1
