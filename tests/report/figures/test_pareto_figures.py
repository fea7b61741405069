import numpy as np
import pandas as pd
from isacbench.bench.store.run_store import read_results
from isacbench.report.figures.pareto_figures import DOMINATED_ALPHA, draw_pareto, draw_stages, shown_snrs
from matplotlib.colors import same_color
from matplotlib.text import Text

from isacbench.bench.run.runner import run
from isacbench.bench.run_times import summarise_points
from isacbench.bench.suites.suite import Suite
from isacbench.report.drawing.style import new_figure, styled
from isacbench.report.figures import run_figures
from isacbench.report.figures.run_figures import draw_run


def legend_of(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def markers_of(axes):
    """Lines of one point with a marker, by their place."""
    return {
        (line.get_xdata()[0], line.get_ydata()[0]): line
        for line in axes.lines
        if len(line.get_xdata()) == 1 and line.get_marker() != "None"
    }


def numbers_of(axes):
    return {text.get_text(): text for text in axes.texts}


def many(timed, n, n_trials=8, snr_db=10.0):
    """Rows of one estimator with n sets of parameters, all crowded into a corner."""
    rng = np.random.default_rng(0)
    parts = [
        timed(n_trials, snr_db, params={"a": {"n": k}}, a=(rng.uniform(0.05, 0.06), rng.uniform(5, 5.5)))
        for k in range(n)
    ]
    return pd.concat([*parts, timed(n_trials, snr_db, b=(1.0, 20.0))])


def test_every_point_has_a_mark_and_both_its_intervals(timed):
    rows = timed(a=(np.linspace(0.01, 0.02, 8), np.linspace(4, 6, 8)), b=(0.05, 3.0))
    points = summarise_points(rows, ())
    (axes,) = draw_pareto(points, "street").axes
    marks = markers_of(axes)
    assert set(marks) == set(zip(1e3 * points["time_s"], points["hausdorff_sum_m_mean"], strict=True))
    a = points.iloc[0]
    bars = np.array([segment for bar in axes.collections for segment in bar.get_segments()])
    level = [[1e3 * a["time_low_s"], 5.0], [1e3 * a["time_high_s"], 5.0]]
    upright = [[1e3 * a["time_s"], a["hausdorff_sum_m_low"]], [1e3 * a["time_s"], a["hausdorff_sum_m_high"]]]
    for expected in (level, upright):
        assert any(np.allclose(bar, expected) for bar in bars)
    assert axes.get_xscale() == "log"


def test_the_frontier_is_a_step_line_from_the_fastest_to_the_edge(timed):
    points = summarise_points(timed(a=(0.01, 5.0), b=(0.02, 4.0), beaten=(0.03, 4.5)), ())
    (axes,) = draw_pareto(points, "street").axes
    (step,) = [line for line in axes.lines if line.get_drawstyle() == "steps-post"]
    x, y = step.get_data()
    assert x.tolist() == [10.0, 10.0, 20.0, axes.get_xlim()[1]]
    assert y.tolist() == [axes.get_ylim()[1], 5.0, 4.0, 4.0]
    alphas = {place: line.get_alpha() for place, line in markers_of(axes).items()}
    assert alphas == {(10.0, 5.0): 1.0, (20.0, 4.0): 1.0, (30.0, 4.5): DOMINATED_ALPHA}


def test_limits_of_one_name_have_lines_and_entries_of_their_own(timed):
    rows = [
        timed(oracle=(1e-6, 1.0), a=(0.01, 5.0)),
        timed(params={"oracle": {"cell": 0.5}}, oracle=(1e-6, 0.5)),
    ]
    figure = draw_pareto(summarise_points(pd.concat(rows), {"oracle"}), "street")
    levels = {
        line.get_ydata()[0]: line.get_linestyle()
        for line in figure.axes[0].lines
        if len(set(line.get_ydata())) == 1
    }
    assert (levels[1.0], levels[0.5]) == ("--", ":")
    entries = [text.get_text() for text in figure.legends[0].get_texts()]
    assert entries[0:3:2] == [f"oracle{cell} (truth merged in cells ± spread)" for cell in ("", "[cell=0.5]")]


def test_a_limit_is_a_level_line_and_does_not_stretch_the_time(timed):
    points = summarise_points(timed(limit=(1e-6, noisy_level()), a=(0.01, 5.0)), {"limit"})
    (axes,) = draw_pareto(points, "street").axes
    levels = [line for line in axes.lines if line.get_linestyle() == "--"]
    assert [set(line.get_ydata()) for line in levels] == [{points.iloc[0]["hausdorff_sum_m_mean"]}]
    assert list(markers_of(axes)) == [(10.0, 5.0)]
    assert axes.get_xlim()[0] > 1
    assert len(axes.patches) == 1  # its confidence band


def noisy_level():
    return np.linspace(2.9, 3.1, 8)


def test_colours_are_those_of_estimators_and_numbers_those_of_their_parameters(timed):
    figure = draw_pareto(summarise_points(many(timed, 3), ()), "street")
    labels = legend_of(figure)
    assert labels == ["1  a[n=0]", "2  a[n=1]", "3  a[n=2]", "4  b", "Pareto frontier"]
    colours = [line.get_color() for line in figure.legends[0].get_lines()]
    assert same_color(colours[0], colours[2])
    assert not same_color(colours[0], colours[3])


def test_where_colours_tell_all_there_are_no_numbers(timed):
    figure = draw_pareto(summarise_points(timed(a=(0.01, 5.0), b=(0.02, 4.0)), ()), "street")
    assert legend_of(figure) == ["a", "b", "Pareto frontier"]
    assert not figure.axes[0].texts


def test_of_forty_crowded_points_all_on_the_frontier_are_numbered_and_no_number_covers_another(timed):
    points = summarise_points(many(timed, 39), ())
    with styled():
        figure = draw_pareto(points, "street")
        figure.draw_without_rendering()
    (axes,) = figure.axes
    numbers = numbers_of(axes)
    assert {str(n) for n in points.loc[points["is_on_frontier"], "number"]} <= set(numbers)
    assert len(numbers) > 10
    # The words alone: an annotation's own box holds its line to the point, too.
    boxes = [Text.get_window_extent(text) for text in numbers.values()]
    for index, box in enumerate(boxes):
        # Boxes of letters are a pixel larger than the letters.
        assert not any(box.padded(-2).overlaps(other.padded(-2)) for other in boxes[:index])
    legend = figure.legends[0].get_window_extent()
    assert 0 <= legend.x0 < legend.x1 <= figure.bbox.width
    assert 0 <= legend.y0 < legend.y1 < axes.get_tightbbox().y0


def test_failures_and_empty_images_are_marked_and_the_legend_says_so(timed):
    rows = timed(good=(0.01, 5.0), shaky=(0.02, 4.0), hasty=(0.03, 3.0), broken=(0.04, 2.0))
    rows.loc[rows.index[rows["estimator"] == "shaky"][:1], ["status", "hausdorff_sum_m"]] = "error", np.nan
    rows.loc[rows["estimator"] == "broken", ["status", "hausdorff_sum_m"]] = "timeout", np.nan
    rows.loc[rows["estimator"] == "hasty", "status"] = "no_detection"
    figure = draw_pareto(summarise_points(rows, ()), "street")
    marks = markers_of(figure.axes[0])
    assert marks[20.0, 4.0].get_marker() == "x"
    assert same_color(marks[30.0, 3.0].get_markerfacecolor(), "white")
    assert len(marks) == 3
    assert legend_of(figure) == [
        "good",
        "shaky",
        "hasty",
        "broken: no score",
        "Pareto frontier",
        "hollow: nothing detected in some trials",
        "failed or missing in some trials",
    ]


def test_a_run_in_which_all_failed_or_with_one_trial_is_drawn(timed):
    for n_trials in (1, 8):
        rows = timed(n_trials, a=(0.01, 5.0))
        assert draw_pareto(summarise_points(rows, ()), "street").axes
        rows[["status", "hausdorff_sum_m"]] = "error", np.nan
        assert legend_of(draw_pareto(summarise_points(rows, ()), "street"))[0] == "a: no score"


def test_of_many_snrs_four_have_panels_on_one_scale_the_lowest_and_the_highest_among_them(timed):
    snrs_db = [-30.0, -20.0, -10.0, 0.0, 10.0, 20.0]
    rows = pd.concat([timed(a=(0.01, 5 - snr_db / 10), snr_db=snr_db) for snr_db in snrs_db])
    figure = draw_pareto(summarise_points(rows, ()), "street")
    assert [axes.get_title() for axes in figure.axes] == ["-30 dB", "-10 dB", "0 dB", "20 dB"]
    assert len({(axes.get_xlim(), axes.get_ylim()) for axes in figure.axes}) == 1
    assert shown_snrs([5.0, 5.0, -5.0]) == [-5.0, 5.0]


def with_stages(rows):
    return rows.assign(
        time_rdm_s=0.25 * rows["time_estimate_s"],
        time_spectrum_s=0.5 * rows["time_estimate_s"],
        time_peaks_s=np.nan,
        peak_memory_mib=12.0,
    )


def test_stages_are_shares_of_the_time_and_what_is_in_none_is_the_rest(timed):
    rows = with_stages(timed(a=(0.01, 5.0), b=(0.02, 4.0), beaten=(0.03, 4.5)))
    figure = draw_stages(rows, summarise_points(rows, ()), "street")
    assert legend_of(figure) == ["rdm", "spectrum", "none of these"]
    (axes,) = figure.axes
    assert [text.get_text() for text in axes.get_yticklabels()] == ["a", "b"]
    bars = [[bar.get_width() for bar in container] for container in axes.containers]
    np.testing.assert_allclose(bars, [[25, 25], [50, 50], [25, 25]])
    assert [text.get_text() for text in axes.texts] == ["10 ms, 12 MiB", "20 ms, 12 MiB"]


def test_stages_of_every_snr_lie_below_each_other_and_within_the_figure(timed):
    name = "an_estimator_with_a_long_name"
    rows = with_stages(pd.concat([timed(**{name: (0.01, 5.0)}, snr_db=snr_db) for snr_db in (-10.0, 10.0)]))
    with styled():
        figure = draw_stages(rows, summarise_points(rows, ()), "street")
        figure.draw_without_rendering()
    assert [axes.get_title() for axes in figure.axes] == ["-10 dB", "10 dB"]
    for axes in figure.axes:
        box = axes.get_tightbbox()
        assert box.x0 >= 0
        assert box.x1 <= figure.bbox.width
    assert figure.legends[0].get_window_extent().y1 < figure.axes[1].get_tightbbox().y0


def test_without_stages_or_without_a_frontier_there_is_no_such_figure(timed):
    rows = timed(a=(0.01, 5.0))
    assert draw_stages(rows, summarise_points(rows, ()), "street") is None
    broken = with_stages(rows).assign(status="error", hausdorff_sum_m=np.nan)
    assert draw_stages(broken, summarise_points(broken, ()), "street") is None


def test_a_run_draws_them_where_its_times_count(plugins, tiny, tmp_path, monkeypatch):
    suite = Suite(
        name="t", scenarios=[str(tiny)], estimators=["blob", "seer", "trouble"], snr_db=[0], trials=2
    )
    folder = tmp_path / "run"
    run(suite, out=folder)
    stored = read_results(folder)
    for name in ("draw_deviations", "draw_scores", "draw_clouds"):
        monkeypatch.setattr(run_figures, name, lambda *_: new_figure(1, 1))
    assert not [path for path in draw_run(folder) if path.stem.startswith("pareto")]
    timed_run = with_stages(stored.records.assign(timing=True))
    monkeypatch.setattr(
        run_figures, "read_results", lambda _: type(stored)(**{**vars(stored), "records": timed_run})
    )
    names = [path.name for path in draw_run(folder)]
    assert names == [
        "deviation.png",
        "curves-tiny.png",
        "radii.png",
        "pareto-tiny.png",
        "stages-tiny.png",
        "clouds-tiny.png",
    ]
