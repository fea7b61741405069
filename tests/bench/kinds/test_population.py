import dataclasses
import json

import numpy as np
import pandas as pd
import pytest

from isacbench.bench.kinds import population
from isacbench.bench.kinds.kind import lines_of
from isacbench.bench.kinds.population import (
    ALL,
    IN_CHARTS,
    IN_TABLES,
    LARGEST_RATIO,
    OWN_SCORES,
    TARGETS,
    PopulationKind,
    PopulationSuite,
    near_chance,
    ratio_charts,
    summarise_population,
    with_ratios,
    with_totals,
)
from isacbench.bench.run.rescoring import rescore
from isacbench.bench.run.runner import run_suite
from isacbench.bench.statistics import deviation_columns, median_interval
from isacbench.model.scenes.scenario import load_scenario
from isacbench.report.figures import draw_charts

KIND = PopulationKind()


def entry(summary, estimator="a", family=ALL, frame=ALL, phases=ALL, snr_db=None):
    """Row of a summary."""
    is_snr = summary["snr_db"].isna() if snr_db is None else summary["snr_db"] == snr_db
    values = {"estimator": estimator, "family": family, "frame": frame, "phases": phases}
    chosen = summary[is_snr & np.all([summary[name] == value for name, value in values.items()], axis=0)]
    assert len(chosen) == 1
    return chosen.iloc[0]


def test_means_and_medians_are_over_scenes_and_not_over_cells(population_rows):
    errors = np.arange(1.0, 9.0) ** 2
    rows = population_rows(families=["town"], a=errors, oracle=2.0)
    # Further cells of a single scene must not give that scene more weight.
    more = rows[rows["scenario"] == "town[seed=7]"].assign(snr_db=30.0)
    found = entry(summarise_population(pd.concat([rows, more], ignore_index=True)))
    assert found["n_scenes"] == 8
    assert found["n_cells"] == 18
    assert (found["gospa_m_mean"], found["gospa_m_band"]) == pytest.approx(
        tuple(deviation_columns(pd.DataFrame({"deviation": errors})).values())
    )
    median = [found[f"ratio_{name}"] for name in ("median", "low", "high")]
    assert median == pytest.approx(median_interval(errors / 2))
    quartiles = [found["ratio_q25"], found["ratio_q75"]]
    assert quartiles == pytest.approx(np.quantile(errors / 2, [0.25, 0.75]).tolist())
    assert found["time_estimate_s_median"] == 0.1


def test_every_level_has_its_own_scenes(population_rows):
    rows = population_rows(families=["town", "crowd"], a=np.arange(8.0), oracle=1.0)
    rows.loc[rows["family"] == "crowd", "gospa_m"] += 100
    rows.loc[rows["snr_db"] == 10, "gospa_m"] += 1000
    summary = summarise_population(rows)
    assert entry(summary, family="town", snr_db=0.0)["gospa_m_mean"] == 3.5
    assert entry(summary, family="crowd", snr_db=10.0)["gospa_m_mean"] == 1103.5
    assert entry(summary, family="crowd")["gospa_m_mean"] == 603.5
    assert entry(summary)["gospa_m_mean"] == 553.5
    paper = entry(summary, family="town", frame="paper", phases="carrier", snr_db=0.0)
    assert (paper["n_scenes"], paper["gospa_m_mean"]) == (2, 5.0)  # the scenes 3 and 7
    levels = summary.groupby("estimator").size()
    assert (levels == 3 * 5 * 3).all()  # families, frames with phases, SNRs, each with all of them
    cells = with_ratios(rows)
    assert len(with_totals(cells)) == 8 * len(cells)


def test_lone_scatterers_have_targets_and_no_ratio_and_others_have_ratios_and_no_targets(population_rows):
    rows = population_rows(a=3.0, oracle=0.0)
    lone = rows["family"] == "sparse"
    rows.loc[lone & (rows["snr_db"] == 10), ["n_resolved", "n_false"]] = [5, 0]
    rows.loc[lone & (rows["snr_db"] == 0), ["n_resolved", "n_false"]] = [3, 2]
    summary = summarise_population(rows)
    sparse, town, both = entry(summary, family="sparse"), entry(summary, family="town"), entry(summary)
    assert np.isnan(sparse["ratio_median"])
    assert town["ratio_median"] == pytest.approx(10.0)  # 3 m over the least denominator, 0.3 m
    assert both["ratio_median"] == pytest.approx(10.0)
    targets = ["n_false_mean", "share_clean_mean", "share_resolved_mean", "share_met_mean"]
    assert sparse[targets].tolist() == pytest.approx([1, 0.5, 0.8, 0.5])
    assert town[targets].isna().all()
    assert both[targets].isna().all()


def test_a_failed_cell_of_lone_scatterers_meets_no_target(population_rows):
    rows = population_rows(families=["sparse"], a=1.0, b=1.0)
    rows["n_resolved"] = 5
    broken = (rows["estimator"] == "a") & (rows["scenario"] == "sparse[seed=0]")
    rows.loc[broken, ["status", "n_resolvable", "n_resolved", "gospa_m"]] = ["error", 0, 0, np.nan]
    found = entry(summarise_population(rows), family="sparse")
    assert found["n_failed"] == 2
    assert found["n_false_mean"] == 0  # what failed has no points, and is not counted
    assert found[["share_clean_mean", "share_resolved_mean", "share_met_mean"]].tolist() == [7 / 8] * 3


def test_targets_of_lone_scatterers_are_rescored_from_clouds(plugins, tiny, tmp_path, monkeypatch):
    def load(name):
        return dataclasses.replace(load_scenario(tiny), name=name, family="sparse", family_version=1)

    monkeypatch.setattr("isacbench.bench.cells.plan.load_scenario", load)
    plan = {"scenarios": ["sparse[seed=1]"], "estimators": ["seer", "trouble"], "snr_db": [20.0]}
    suite = PopulationSuite(name="p", version=1, trials=1, **plan)
    seen, broken = run_suite(suite, tmp_path / "run").rows.to_dict("records")
    assert [seen[name] for name in ("n_resolvable", "n_resolved", "n_false")] == [3, 3, 0]
    assert [broken[name] for name in ("family", "frame", "coherent_phase")] == ["sparse", "panel", True]
    assert rescore(tmp_path / "run").changes == []
    monkeypatch.setattr(population, "RESOLVABLE_CELLS", 0.0)
    changes = rescore(tmp_path / "run").changes
    assert {change.column: change.n_rows for change in changes} == {"n_resolvable": 1, "n_resolved": 1}


@pytest.fixture
def records(population_rows):
    """Two families, two estimators and two references."""
    return population_rows(["town", "crowd", "sparse"], blob=4.0, nomp4d=3.0, oracle=2.0, chance=9.0)


@pytest.fixture
def part():
    """Rows of a summary for three estimators and chance, which is near in nothing."""
    names = ["blob", "nomp4d", "esprit2d", "chance"]
    table = pd.DataFrame({"estimator": names, "sees_truth": [False, False, False, True]})
    for name in (*IN_TABLES, "deviation"):
        column = f"{name}_{'median' if name == 'ratio' else 'mean'}"
        is_higher_better = OWN_SCORES[name].is_higher_better
        table[column] = [0.3, 0.5, 0.9, 0.0] if is_higher_better else [1.0, 2.0, 3.0, 100.0]
    return table


@pytest.mark.parametrize(
    ("column", "chance", "is_near"),
    [
        ("hausdorff_sum_m_mean", 2.39, True),
        ("hausdorff_sum_m_mean", 2.41, False),
        ("precision_mean", 0.41, True),
        ("precision_mean", 0.39, False),
    ],
)
def test_chance_is_near_from_a_fifth_worse_than_the_median_estimator_on(part, column, chance, is_near):
    part.loc[3, column] = chance
    assert near_chance(part) == ([column] if is_near else [])


def test_the_better_one_of_chance_and_no_point_at_all_counts_and_without_both_nothing_is_near(part):
    empty = part.iloc[3:].assign(estimator="empty", n_false_mean=0.0)
    assert near_chance(pd.concat([part, empty], ignore_index=True)) == ["n_false_mean"]
    assert near_chance(part.assign(ratio_median=np.nan)) == near_chance(part.iloc[:3]) == []


def test_the_summary_marks_families_where_chance_comes_near_and_so_do_their_tables(population_rows):
    records = population_rows(["town", "crowd"], snrs_db=[10.0], blob=4.0, nomp4d=3.0, oracle=2.0, chance=9.0)
    in_crowd = records["family"] == "crowd"
    # That of the others is 4 and 3.
    records.loc[records["estimator"] == "chance", "recall"] = np.where(in_crowd, 3.4, 0.1)[3::4]
    marks = KIND.summary(records).groupby("family")["near_chance"].first()
    assert {name: "recall_mean" in json.loads(marks[name]) for name in ("crowd", "town")} == {
        "crowd": True,
        "town": False,
    }
    tables = {one.title.partition(",")[0]: one for one in KIND.tables(records) if one.is_detail}
    assert "recall †" in tables["crowd"].headings
    assert "recall" in tables["town"].headings
    assert "chance or no point at all comes near" in tables["crowd"].title


def test_what_is_printed_has_references_below_and_details_are_for_the_file(records):
    tables = KIND.tables(records)
    printed = [table for table in tables if not table.is_detail]
    assert [table.title.partition(",")[0] for table in printed] == [
        "All scenes",
        "sparse",
        "Median ratio by family",
        "Median ratio by frame and phases",
    ]
    # Every family and all together at both SNRs, the families also over both.
    assert len(tables) - len(printed) == 4 * 2 + 2
    means, targets, ratios, _ = printed
    names = [row[0] for row in means.texts]
    assert names[:2] == ["blob", "nomp4d"]
    assert set(names[2:]) >= {"oracle (ref.)"}
    assert means.texts[1][1:3] == ["1.50", "3.00 ±0.00"]
    assert {one.name for one in TARGETS.values()} <= {one.removesuffix(" †") for one in targets.headings}
    assert ratios.headings == ["estimator", "town", "crowd"]
    assert ratios.texts[0] == ["blob", "2.00 (2.00-2.00)", "2.00 (2.00-2.00)"]


@pytest.mark.parametrize(
    ("n", "band"), [(4, "4 scenes, no confidence band below 5"), (5, "5 scenes, 95 % confidence band")]
)
def test_a_title_says_how_many_scenes_there_are_and_whether_they_are_enough_for_a_band(
    population_rows, n, band
):
    rows = population_rows(["", "town"], n_scenes=n, blob=1.0)
    assert f"hand-made, mean over 0, 10 dB: {band}" in [one.title for one in KIND.tables(rows)]


def test_failed_cells_are_counted_and_an_interrupted_population_has_tables_of_what_there_is(records):
    lost = (records["family"] == "crowd") & (records["snr_db"] == records["snr_db"].max())
    records.loc[(records["estimator"] == "blob") & (records["family"] == "town"), "status"] = "timeout"
    tables = KIND.tables(records[~lost])
    titles = [table.title.partition(":")[0] for table in tables]
    assert f"crowd, {records['snr_db'].min():g} dB" in titles
    assert f"crowd, {records['snr_db'].max():g} dB" not in titles
    assert (tables[0].headings[-2], tables[0].texts[0][-2]) == ("failed: cells", "16")
    # Where all failed, there are no numbers.
    records[records.select_dtypes("float").columns.difference(["snr_db"])] = np.nan
    table = KIND.tables(records.assign(status="error"))[0]
    assert table.headings[:2] == ["estimator", "failed: cells"]
    assert all(int(row[1]) for row in table.texts)


@pytest.fixture
def drawn(population_rows):
    """Rows of three families: ratios from 1 to 4.5, and one that is far off."""
    return population_rows(["town", "crowd", "sparse"], a=np.arange(2.0, 10.0), b=1e6, oracle=2.0)


def test_every_scene_is_a_dot_in_the_row_of_its_estimator_and_references_are_lines(drawn):
    (group,) = ratio_charts(with_ratios(drawn), lines_of(drawn))
    places = [f"{family}, {snr} dB" for snr in (0, 10) for family in ("town", "crowd")]
    assert [chart.title for chart in group.charts] == places
    for chart in group.charts:
        dots = [one for one in chart.series if one.style.symbol == "circle"]
        ratio, height = (np.concatenate([getattr(one, name) for one in dots]) for name in "xy")
        assert sorted(ratio[height < 0.5]) == pytest.approx(np.arange(2.0, 10.0) / 2)
        assert ratio[height > 0.5].tolist() == [LARGEST_RATIO] * 8
        (reference,) = [one for one in chart.series if one.mark == "line"]
        assert (reference.x, reference.style.dash) == ([1, 1], "dash")
        a, b = [one for one in chart.series if one.style.symbol == "line-ns"]
        assert [*a.x_low, *a.x, *a.x_high] == pytest.approx(
            np.quantile(ratio[height < 0.5], [0.25, 0.5, 0.75])
        )
        assert (a.y, b.y) == ([0], [1])
    assert list(chart.y.categories) == ["a", "b"]
    assert (chart.x.log, chart.x.title) == (True, "ratio to the oracle")


def test_scores_have_a_row_each_and_families_a_column_on_one_scale(drawn):
    ratios, scores, targets = KIND.charts(drawn)
    assert (ratios.stem, scores.n_columns) == ("ratios", 4)
    panels = np.reshape(np.array(scores.charts, dtype=object), (-1, 4))
    assert [chart.title for chart in panels[0]] == ["all scenes", "town", "crowd", "sparse"]
    axes = [OWN_SCORES[name].name for name in IN_CHARTS]
    assert [chart.y.title for chart in panels[:, 0]] == axes
    assert list(panels[0, 1].series[0].y) == pytest.approx([2.75, 2.75])
    assert not panels[0, 3].series
    assert len({chart.y for chart in panels[axes.index("velocity error [m/s]")]}) == 1
    labels = [one.label for one in panels[1, 0].series]
    assert labels == ["a", "b", "oracle (truth merged in cells)"]
    assert targets.stem == "targets-sparse"
    # A family without a score leaves a gap in the figure, and no empty panel.
    names = [axes.get_title() for axes in draw_charts(scores).axes]
    assert names == ["all scenes", "town", "crowd"] + ["all scenes", "town", "crowd", "sparse"] * 5


def test_targets_of_lone_scatterers_have_a_chart_each(drawn):
    targets = KIND.charts(drawn.assign(n_false=2))[-1]
    assert [chart.y.title for chart in targets.charts] == [one.name for one in TARGETS.values()]
    assert list(targets.charts[0].series[0].y) == [2, 2]
    assert targets.title == "sparse: means over 8 scenes, 95 % confidence band"


def test_without_an_oracle_there_are_no_ratios(population_rows):
    rows = population_rows(["town"], n_scenes=2, a=2.0, b=3.0)
    (scores,) = KIND.charts(rows)
    assert scores.stem == "scores"
    assert "no confidence band" in scores.title
