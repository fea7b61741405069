import json

import numpy as np
import pandas as pd
import pytest

from isacbench.bench.kinds.population import PopulationKind, near_chance
from isacbench.report.table_texts import TERMINAL_WIDTH, rich_table


@pytest.fixture
def records(population_rows):
    """Two families, two estimators and two references."""
    rows = population_rows(families=["town", "crowd", "sparse"], blob=4.0, nomp4d=3.0, oracle=2.0, chance=9.0)
    return rows


def part(higher=(), **scores):
    """Rows of a summary in which all is equal but what is given for blob, nomp4d, esprit2d and chance."""
    names = ["blob", "nomp4d", "esprit2d", "chance"]
    low = ["ratio_median", "hausdorff_sum_m_mean", "velocity_error_mps_mean", "deviation_mean"]
    high = ["precision_mean", "recall_mean", "share_clean_mean", "share_resolved_mean", "share_met_mean"]
    table = pd.DataFrame({"estimator": names, "sees_truth": [False, False, False, True]})
    for name in [*low, "n_false_mean"]:
        table[name] = [1.0, 2.0, 3.0, 100.0]
    for name in high:
        table[name] = [0.3, 0.5, 0.9, 0.0]
    return table.assign(**scores)


def test_chance_is_near_from_a_fifth_worse_than_the_median_estimator_on():
    assert near_chance(part()) == []
    for column, chance, is_near in (
        ("hausdorff_sum_m_mean", 0.5, True),
        ("hausdorff_sum_m_mean", 2.39, True),
        ("hausdorff_sum_m_mean", 2.41, False),
        ("precision_mean", 0.95, True),
        ("precision_mean", 0.41, True),
        ("precision_mean", 0.39, False),
    ):
        table = part()
        table.loc[3, column] = chance
        assert near_chance(table) == ([column] if is_near else []), (column, chance)


def test_the_better_one_of_chance_and_no_point_at_all_counts():
    table = pd.concat(
        [part(), part().iloc[3:].assign(estimator="empty", n_false_mean=0.0)], ignore_index=True
    )
    assert near_chance(table) == ["n_false_mean"]


def test_nothing_is_near_chance_without_chance_or_without_numbers():
    assert near_chance(part().query("estimator != 'chance'")) == []
    assert near_chance(part(ratio_median=np.nan)) == []


def test_the_summary_marks_families_where_chance_comes_near(population_rows):
    records = population_rows(["town", "crowd"], snrs_db=[10.0], blob=4.0, nomp4d=3.0, oracle=2.0, chance=9.0)
    in_crowd = (records["estimator"] == "chance") & (records["family"] == "crowd")
    records.loc[in_crowd, "recall"] = 3.4  # the others: 4 and 3
    records.loc[(records["estimator"] == "chance") & ~in_crowd, "recall"] = 0.1
    summary = PopulationKind().summary(records)
    marked = {
        family: set(part["near_chance"].map(json.loads).explode().dropna())
        for family, part in summary.groupby("family")
    }
    assert "recall_mean" in marked["crowd"]
    assert "recall_mean" not in marked["town"]
    titles = {
        grid.title.partition(",")[0]: grid for grid in PopulationKind().tables(records) if grid.is_detail
    }
    assert "recall †" in titles["crowd"].header
    assert "recall" in titles["town"].header
    assert "chance or no point at all comes near" in titles["crowd"].title


def test_what_is_printed_fits_a_terminal_with_references_below_and_details_are_for_the_file(records):
    grids = PopulationKind().tables(records)
    printed = [grid for grid in grids if not grid.is_detail]
    assert [grid.title.partition(",")[0] for grid in printed] == [
        "All scenes",
        "Median ratio by family",
        "Median ratio by frame and phases",
        "Targets of sparse",
    ]
    assert all(rich_table(grid).title is not None for grid in printed)
    assert all(max(map(len, grid.header)) < TERMINAL_WIDTH for grid in printed)
    # Every family and all together at both SNRs, the families also over both; and the targets at each.
    assert len(grids) - len(printed) == 4 * 2 + 3 + 2
    means, ratios, *_ = printed
    names = [row[0] for row in means.rows]
    assert names[:2] == ["blob", "nomp4d"]
    assert set(names[2:]) >= {"oracle (ref.)"}
    assert means.rows[1][1:3] == ["1.50", "3.00 ±0.00"]
    assert ratios.header == ["estimator", "town", "crowd"]
    assert ratios.rows[0] == ["blob", "2.00 (2.00-2.00)", "2.00 (2.00-2.00)"]


def test_a_title_says_how_many_scenes_there_are_and_whether_they_are_enough_for_a_band(population_rows):
    for n, band in ((4, "4 scenes, no confidence band below 5"), (5, "5 scenes, 95 % confidence band")):
        grid = PopulationKind().tables(population_rows(["town"], n_scenes=n, blob=1.0))[0]
        assert grid.title == f"All scenes, mean over 0, 10 dB: {band}"


def test_a_population_in_which_all_cells_failed_is_told_without_numbers(population_rows):
    records = population_rows(["town"], snrs_db=[10.0], blob=4.0, oracle=2.0)
    scores = records.select_dtypes("float").columns.difference(["snr_db"])
    records[scores] = np.nan
    records["status"] = "error"
    grids = PopulationKind().tables(records)
    assert grids[0].header[:2] == ["estimator", "Hausdorff [m]"]
    assert all("failed" in row[1] for row in grids[0].rows)


def test_a_population_that_was_interrupted_has_tables_of_what_there_is_and_tells_failed_cells(records):
    lost = (records["family"] == "crowd") & (records["snr_db"] == records["snr_db"].max())
    records.loc[(records["estimator"] == "blob") & (records["family"] == "town"), "status"] = "timeout"
    grids = PopulationKind().tables(records[~lost])
    titles = [grid.title.partition(":")[0] for grid in grids]
    assert f"crowd, {records['snr_db'].min():g} dB" in titles
    assert f"crowd, {records['snr_db'].max():g} dB" not in titles
    assert "(16 failed)" in grids[0].rows[0][1]
