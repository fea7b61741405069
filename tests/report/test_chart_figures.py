"""Charts as panels of a figure: what is drawn where, and that nothing covers anything else."""

import numpy as np
import pytest
from matplotlib.colors import same_color

from isacbench.charts import Axis, Chart, ChartGroup, LineStyle, Series, assign_lines
from isacbench.errors import InputError
from isacbench.report.figures import (
    draw_charts,
    drawable,
    drawings_of,
    save_figures,
    styled,
)

RED, BLUE = LineStyle("#FF0000", "dashdot", "square"), LineStyle("#0000FF", "solid", "circle")
X, Y = Axis("SNR [dB]"), Axis("error [m]")


def drawn(*series, x=X, y=Y, lines=()):
    """Panel of a single chart."""
    (axes,) = draw_charts(ChartGroup("stem", "title", [Chart("", x, y, series, lines)])).axes
    return axes


def laid_out(*charts, title="title", **options):
    """Figure of some charts, once all its texts have their places."""
    with styled():
        figure = draw_charts(ChartGroup("stem", title, charts, **options))
        figure.draw_without_rendering()
    return figure


def legend_of(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def corners_of(band):
    return {tuple(corner) for path in band.get_paths() for corner in path.vertices.round(9)}


def test_a_line_joins_its_points_inside_its_band_with_dash_colour_and_symbol():
    axes = drawn(Series("a", [-10, 0, 10], [3, 2, 1], [2, 1, 0], [5, 4, 3], style=RED))
    (line,), (band,) = axes.lines, axes.collections
    np.testing.assert_array_equal(line.get_xydata(), [[-10, 3], [0, 2], [10, 1]])
    assert (line.get_linestyle(), line.get_marker()) == ("-.", "s")
    assert same_color(line.get_color(), "#FF0000")
    assert {(-10, 2), (-10, 5), (10, 0), (10, 3)} <= corners_of(band)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("SNR [dB]", "error [m]")


def test_where_ends_are_missing_there_is_a_line_and_no_band():
    nothing = [np.nan] * 3
    axes = drawn(Series("a", [0, 1, 2], [3, 2, 1], nothing, nothing), Series("b", [0, 1, 2], [np.nan, 2, 1]))
    assert [len(line.get_xdata()) for line in axes.lines] == [3, 3]
    assert not corners_of(axes.collections[0])


@pytest.mark.parametrize("symbol", ["circle", ""])
def test_a_single_place_is_seen_and_its_interval_upright(symbol):
    axes = drawn(Series("a", [3.0], [2.0], [1.0], [4.0], style=LineStyle("", "dash", symbol)))
    assert axes.lines[0].get_marker() == ("o" if symbol else "_")
    np.testing.assert_array_equal(axes.collections[0].get_segments(), [[[3, 1], [3, 4]]])


def test_series_side_by_side_share_the_tick_of_their_place():
    axes = drawn(Series("a", [9.9], [2.0], tick=10.0), Series("b", [10.0, 10.2], [1.0, 1.0], tick=10.0))
    assert list(axes.get_xticks()) == [10.0]


def test_what_lies_beyond_the_limits_is_at_the_edge_on_a_logarithmic_axis_zero_too():
    x = [0, 1, 2, 3]
    axes = drawn(Series("a", x, [0.0, 1e-9, 0.1, 7.0], x, x), y=Axis("e", log=True, limits=(1e-3, 1.0)))
    assert axes.get_yscale() == "log"
    assert axes.lines[0].get_ydata().tolist() == [1e-3, 1e-3, 0.1, 1.0]
    assert axes.get_ylim()[0] < 1e-3 < 1.0 < axes.get_ylim()[1]
    linear = drawn(Series("a", x, [-5.0, 0.5, np.nan, 9.0]), y=Axis("e", limits=(0.0, 1.0)))
    np.testing.assert_array_equal(linear.lines[0].get_ydata(), [0.0, 0.5, np.nan, 1.0])
    assert linear.get_ylim() == (0.0, 1.0)


def test_without_limits_a_logarithmic_axis_leaves_out_what_is_not_positive_and_bands_end_a_decade_below():
    axes = drawn(Series("a", [0, 1, 2], [0.0, 0.1, 1.0], [0.0, 0.0, 0.5], [1, 1, 2]), y=Axis("e", log=True))
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), [np.nan, 0.1, 1.0])
    assert {(1, 0.01), (2, 0.5)} <= corners_of(axes.collections[0])


def test_points_have_bars_in_both_directions_and_open_symbols_are_not_filled():
    style = LineStyle("#FF0000", "", "circle-open")
    points = Series("a", [5, 8], [2, 3], [1, 2], [4, 5], [4, 7], [7, 9], mark="points", style=style)
    axes = drawn(points)
    level, upright = (bars.get_segments() for bars in axes.collections)
    np.testing.assert_array_equal(level, [[[4, 2], [7, 2]], [[7, 3], [9, 3]]])
    np.testing.assert_array_equal(upright, [[[5, 1], [5, 4]], [[8, 2], [8, 5]]])
    assert axes.lines[0].get_linestyle() == "None"
    assert same_color(axes.lines[0].get_markerfacecolor(), "white")


def test_steps_keep_their_height_up_to_the_next_and_lines_lie_across():
    axes = drawn(Series("frontier", [1, 2, 4], [5, 4, 4], mark="step"), lines=[1.5])
    step, across = axes.lines
    assert step.get_drawstyle() == "steps-post"
    np.testing.assert_array_equal(step.get_xydata(), [[1, 5], [2, 4], [4, 4]])
    assert (across.get_ydata(), across.get_linestyle()) == ([1.5, 1.5], "--")


def test_bars_of_several_series_stand_in_a_row_at_the_names_of_their_places():
    parts = [
        Series(name, shares, [0, 1], mark="bar", style=RED)
        for name, shares in (("p", [25, 40]), ("q", [75, 60]))
    ]
    axes = drawn(*parts, y=Axis("", categories=["$a", "b"]))
    assert [[bar.get_x() for bar in bars] for bars in axes.containers] == [[0, 0], [25, 40]]
    assert [[bar.get_width() for bar in bars] for bars in axes.containers] == [[25, 40], [75, 60]]
    assert [text.get_text() for text in axes.get_yticklabels()] == [r"\$a", "b"]
    low, high = axes.get_ylim()
    assert low > 1 > 0 > high  # the first above


def test_one_legend_has_each_label_once_grey_where_its_series_have_several_colours():
    chart = Chart(
        "", X, Y, [Series("a", [0, 1], [0, 1], style=style) for style in (RED, BLUE)] + [Series("", [0], [0])]
    )
    bar = Chart(
        "", X, Y, [Series("a", [0, 1], [0, 1], style=BLUE), Series("bar", [1], [0], mark="bar", style=RED)]
    )
    figure = draw_charts(ChartGroup("stem", "title", [chart, bar]))
    assert legend_of(figure) == ["a", "bar"]
    assert same_color(figure.legends[0].get_lines()[0].get_color(), "0.4")
    full = draw_charts(ChartGroup("stem", "title", [bar]))
    assert same_color(full.legends[0].get_lines()[0].get_color(), "#0000FF")


def test_what_is_full_in_one_panel_is_full_in_the_legend_whatever_the_order_of_the_panels():
    symbols = "square-open", "square"
    series = [Series("a", [1], [1], mark="points", style=LineStyle("#0000FF", "", one)) for one in symbols]
    figure = draw_charts(ChartGroup("stem", "title", [Chart("", X, Y, [one]) for one in series]))
    (entry,) = figure.legends[0].get_lines()
    assert entry.get_marker() == "s"
    assert same_color(entry.get_markerfacecolor(), "#0000FF")


def test_the_legend_says_that_there_is_no_score_where_no_chart_has_one():
    labels = ["a", "b: no score"], ["a: no score", "b: no score"]
    charts = [Chart("", X, Y, [Series(label, [0, 1], [0, 1]) for label in names]) for names in labels]
    assert legend_of(draw_charts(ChartGroup("stem", "title", charts))) == ["a", "b: no score"]


def test_names_are_drawn_as_text_and_never_as_mathematics():
    figure = laid_out(Chart("$x$", X, Axis("$y$"), [Series("$z$", [0, 1], [0, 1])]), title="$t$\nsecond")
    (axes,) = figure.axes
    texts = [axes.get_title(), axes.get_ylabel(), *legend_of(figure)]
    assert texts == [r"\$x\$", r"\$y\$", r"\$z\$"]
    assert figure.get_suptitle() == "\\$t\\$\nsecond"


LONG = {(f"e{n}", "{}"): f"e{n}[detector=ca[pfa=1e-{n}],k=1]" for n in range(12)}


@pytest.mark.parametrize(("n_charts", "n_columns"), [(1, 4), (5, 4), (6, 3), (2, 1)])
def test_panels_titles_and_a_legend_of_twelve_long_labels_lie_within_the_figure_and_cover_nothing(
    n_charts, n_columns
):
    series = [
        Series(line.label, [0, 1], [n, n + 1], style=line.style)
        for n, line in enumerate(assign_lines(LONG).values())
    ]
    charts = [
        Chart(
            f"chart {n} of a scene: a title that is {'very ' * 8}long",
            X,
            Axis("root mean square error [m]"),
            series,
        )
        for n in range(n_charts)
    ]
    figure = laid_out(
        *charts, title=f"A scene: mean of 10 trials, and {'many words more ' * 6}", n_columns=n_columns
    )
    legend = figure.legends[0].get_window_extent()
    assert len(legend_of(figure)) == 12
    boxes = [axes.get_tightbbox() for axes in figure.axes] + [figure._suptitle.get_window_extent(), legend]
    assert not any(one.overlaps(other) for k, one in enumerate(boxes) for other in boxes[:k])
    assert all(figure.bbox.padded(2).containsx(x) for box in boxes for x in box.intervalx)
    assert all(figure.bbox.padded(2).containsy(y) for box in boxes for y in box.intervaly)
    assert len({axes.get_position().width.round(3) for axes in figure.axes}) == 1


def test_long_names_of_places_leave_room_for_bars_and_panels_beside_each_other_share_them():
    y = Axis("", categories=[f"an_estimator_with_a_long_name[n={n}]: 12.3 ms, 40 MiB" for n in range(3)])
    points = Series("p", [1, 2, 3], [0, 1, 2], mark="points", style=RED)
    figure = laid_out(Chart("a", X, y, [points]), Chart("b", X, y, [points]), panel_in=(4.0, 1.5))
    first, second = figure.axes
    assert [text.get_text() for text in second.get_yticklabels()] == [""] * 3
    assert first.get_tightbbox().x0 >= 0
    assert first.get_position().width > 0.15


def test_figures_are_written_by_stem_and_extension_each_in_its_format(tmp_path):
    groups = [
        ChartGroup(stem, "", [Chart("", X, Y, [Series(f"{n}", [0, 1], [n, 1])])])
        for n, stem in enumerate("ab")
    ]
    for extension, magic in (("png", b"\x89PNG"), ("svg", b"<?xml")):
        paths = save_figures(drawings_of(groups), tmp_path / "figures", extension)
        assert [path.name for path in paths] == [f"a.{extension}", f"b.{extension}"]
        assert all(path.read_bytes().startswith(magic) for path in paths)
    with pytest.raises(InputError, match=r"\.png, \.pdf or \.svg"):
        save_figures(drawings_of(groups), tmp_path, "gif")


def test_names_are_drawn_without_missing_glyphs():
    assert drawable("$x$ é_a\n街") == "\\$x\\$ é_a\ufffd\ufffd"


def test_a_point_without_an_interval_has_no_bar_on_a_logarithmic_axis():
    axes = drawn(Series("a", [0.0], [0.2], [np.nan], [np.nan], mark="points"), y=Axis("e", log=True))
    (bars,) = axes.collections
    assert not any(np.isfinite(segment).any() for segment in bars.get_segments())
