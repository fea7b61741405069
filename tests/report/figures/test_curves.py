import numpy as np
import pandas as pd
import pytest
from isacbench.report.figures.curves import draw_deviations, draw_radii, draw_scores

from isacbench.metrics.one_to_one import Curve
from isacbench.report.drawing.style import assign_looks, styled
from isacbench.report.figures import curves

SNR_DB = [-10.0, 0.0, 10.0]
SCORES = [
    "deviation",
    "hausdorff_sum_m",
    "density",
    "velocity_nmse",
    "hausdorff_xy_m",
    "hausdorff_xz_m",
    "hausdorff_yz_m",
    "chamfer_m",
    "gospa_m",
    "gospa_skill",
    "velocity_error_mps",
    "f_score",
    "objects_detected",
    "n_objects_false",
    "precision",
    "recall",
]
LOOKS = assign_looks({("a", "{}"): "a", ("limit", "{}"): "limit"}, bounds={"limit"})
COMPETITOR = {key: look for key, look in LOOKS.items() if not look.is_bound}


def summary_of(scenario="street", snr_db=SNR_DB, half=0.5, **means):
    """Summary whose scores all have the mean `means[estimator]` at every SNR."""
    parts = []
    for estimator, mean in means.items():
        part = pd.DataFrame({"scenario": scenario, "estimator": estimator, "params": "{}", "snr_db": snr_db})
        for score in SCORES:
            part = part.assign(**{f"{score}_mean": mean, f"{score}_band": half})
        parts.append(part.assign(n_cells=10))
    # Out of order, as a merged run is.
    return pd.concat(parts).iloc[::-1].reset_index(drop=True)


def panels_of(figure):
    return {axes.get_title().replace("\n", " "): axes for axes in figure.axes}


def legend_of(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_every_score_has_a_panel_whose_axis_names_it_with_its_unit_and_shares_go_from_0_to_1():
    figure = draw_scores(summary_of(a=0.1, limit=0.2), "street", LOOKS, radius_m=2.5)
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert len(set(labels)) == len(SCORES)
    assert [label.endswith(" [m]") for label in labels] == [score.endswith("_m") for score in SCORES]
    assert "velocity error [m/s]" in labels
    assert {axes.get_xlabel() for axes in figure.axes} == {"SNR [dB]"}
    assert "Share of estimated points within 2.5 m of a true scatterer" in panels_of(figure)
    assert {axes.get_ylim() for axes in figure.axes[-2:]} == {(-0.0309, 1.03)}


def test_a_line_joins_the_means_in_order_of_snr_inside_its_band():
    axes = draw_deviations(summary_of(a=[3.0, 2.0, 1.0], limit=0.5), LOOKS).axes[0]
    line, bound = axes.lines
    np.testing.assert_array_equal(line.get_xydata(), np.column_stack([SNR_DB, [3.0, 2.0, 1.0]]))
    assert bound.get_linestyle() == "--"
    corners = axes.collections[0].get_paths()[0].vertices
    assert {(10.0, 0.5), (10.0, 1.5), (-10.0, 2.5), (-10.0, 3.5)} <= set(map(tuple, corners))


def test_few_trials_have_a_line_and_no_band_and_the_title_says_so():
    figure = draw_deviations(summary_of(a=[3.0, 2.0, 1.0], half=np.nan).assign(n_cells=2), COMPETITOR)
    axes = figure.axes[0]
    assert figure.get_suptitle().endswith("\nmean of 2 trials, no confidence band below 5")
    assert len(axes.lines[0].get_xdata()) == 3
    assert not any(path.vertices.size for path in axes.collections[0].get_paths())


def test_a_limit_with_a_single_snr_is_seen():
    axes = draw_deviations(summary_of(snr_db=[3.0], a=2.0, limit=1.0), LOOKS).axes[0]
    assert axes.lines[1].get_marker() == "_"
    assert list(axes.get_xticks()) == [3.0]


def test_the_velocity_error_is_logarithmic_and_zero_is_drawn_at_its_lower_edge():
    figure = draw_scores(summary_of(a=[3e-2, 2e-3, 0.0], limit=0.0), "street", LOOKS, 1.0)
    axes = figure.axes[SCORES.index("velocity_nmse")]
    assert axes.get_yscale() == "log"
    assert axes.get_ylabel() == "velocity NMSE (less: at the edge)"
    lower = axes.get_ylim()[0]
    assert lower < axes.lines[1].get_ydata()[0] == axes.lines[0].get_ydata()[-1] < 2e-3
    assert [panel.get_yscale() for panel in figure.axes].count("log") == 1


def test_what_has_no_score_is_said_in_the_legend(monkeypatch):
    monkeypatch.setattr(curves, "PANELS", curves.PANELS[:4])
    figure = draw_scores(summary_of(a=np.nan, limit=1.0), "street", LOOKS, 1.0)
    assert legend_of(figure) == ["a: no score", "limit (sees the truth)"]
    draw_scores(summary_of(a=np.nan), "street", COMPETITOR, 1.0)


def test_a_huge_band_does_not_dwarf_the_lines():
    axes = draw_deviations(summary_of(a=[3.0, 2.0, 1.0], half=1e3), LOOKS).axes[0]
    assert axes.get_ylim()[1] == pytest.approx(1.06 * 1.5 * 3.0)


def test_deviations_of_all_scenarios_stand_side_by_side_on_one_scale():
    summary = pd.concat([summary_of("one", a=4.0), summary_of("two$", a=8.0)])
    figure = draw_deviations(summary, LOOKS)
    assert list(panels_of(figure)) == ["one", r"two\$"]
    assert figure.axes[0].get_ylim() == figure.axes[1].get_ylim()


def test_long_labels_do_not_overlap_in_the_legend(monkeypatch):
    monkeypatch.setattr(curves, "PANELS", curves.PANELS[:4])
    labels = {(f"e{n}", "{}"): f"e{n}[detector=ca[pfa=1e-{n}],far=1.25]" for n in range(12)}
    summary = pd.concat([summary_of(**{name: 2.0}) for name, _ in labels])
    with styled():
        figure = draw_scores(summary, "street", assign_looks(labels, bounds=()), 1.0)
        figure.draw_without_rendering()
    legend = figure.legends[0].get_window_extent()
    assert 0 <= legend.x0 < legend.x1 <= figure.bbox.width
    assert legend.y1 < min(axes.get_tightbbox().y0 for axes in figure.axes)


def test_the_title_tells_the_snr_after_all_gains():
    figure = draw_scores(summary_of(a=0.1, limit=0.2), "street", LOOKS, radius_m=1.0, gain_db=54.03)
    assert figure.get_suptitle().endswith("\na median scatterer after all gains: SNR +54.0 dB")


def test_scores_over_the_radius_are_means_over_images_and_the_legend_has_the_area():
    radius_m = np.array([0.1, 1.0, 4.0])
    one, other = (Curve(radius_m, *(share * np.ones((3, 3)))) for share in (0.2, 0.6))
    figure = draw_radii({("a", "{}"): [one, other], ("limit", "{}"): []}, LOOKS, "title")
    assert [axes.get_ylabel() for axes in figure.axes] == ["F-score", "precision", "recall"]
    for axes in figure.axes:
        (line,) = axes.lines
        np.testing.assert_allclose(line.get_xdata(), radius_m)
        np.testing.assert_allclose(line.get_ydata(), 0.4)
    assert legend_of(figure) == ["a: area 0.40"]
