"""Charts and tables as data: styles and labels of estimators, series of a summary, texts of a table."""

import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.charts import (
    DETECTORS,
    ESTIMATORS,
    LONGEST_LABEL,
    Column,
    Table,
    assign_lines,
    decades,
    line_series,
    linear_limits,
    number_table,
    rows_of,
    short_labels,
    spread_rows,
    text_table,
)


def labels_of(*names):
    return {(name, "{}"): name for name in names}


some_variants = st.tuples(st.sampled_from(["a", "b", 40 * "c"]), st.text("xyz=,", max_size=50))
some_labels = st.lists(some_variants, unique=True).map(
    lambda pairs: {(name, text): f"{name}[{text}]" if text else name for name, text in pairs}
)


@pytest.mark.parametrize("names", [ESTIMATORS, DETECTORS])
def test_a_colour_belongs_to_a_name_whatever_else_is_shown(names):
    together = assign_lines(labels_of(*names))
    assert len({line.style.colour for line in together.values()}) == len(names)
    backwards = assign_lines(labels_of("oracle", *names[::-1]), ["oracle"])
    for variant in labels_of(*names):
        alone = assign_lines({variant: "label"})
        colours = {found[variant].style.colour for found in (together, backwards, alone)}
        assert len(colours) == 1
    of_a_run = assign_lines(labels_of("fft4d (first run)", "fft4d"))
    assert len({line.style.symbol for line in of_a_run.values()}) == 2


def test_variants_of_one_name_have_styles_of_their_own():
    variants = {("fft4d", str(n)): f"fft4d[n={n}]" for n in range(18)}
    assert len({line.style for line in assign_lines(variants).values()}) == 18


def test_references_are_dashed_without_symbol_and_in_the_colour_of_text_and_nothing_else_is():
    references = ["oracle", "chance", "mine"]
    found = assign_lines(labels_of("fft4d", *references, *"abcdefghij"), references)
    bounds = [line for line in found.values() if line.is_reference]
    assert [line.label for line in bounds] == [
        "oracle (truth merged in cells)",
        "chance (zero skill)",
        "mine (sees the truth)",
    ]
    assert bounds[0].style.dash == "dash"
    assert len({line.style.dash for line in bounds}) == 3
    for line in found.values():
        assert (line.style.colour == "") == (line.style.symbol == "") == line.is_reference
        assert line.is_reference or line.style.dash != "dash"


@given(some_labels)
def test_short_labels_are_unique_and_short_and_a_table_says_what_numbers_stand_for(labels):
    short = short_labels(labels)
    assert list(short) == list(labels)
    assert len(set(short.values())) == len(labels)
    assert all(len(text) <= LONGEST_LABEL for (name, _), text in short.items() if name != 40 * "c")
    told = dict(row for table in number_table(labels) for row in table.texts)
    assert {short[one]: labels[one] for one in labels if short[one] != labels[one]} == told


SUMMARY = pd.DataFrame(
    {
        "estimator": ["a"] * 3 + ["b"] * 3,
        "params": "{}",
        "snr_db": 2 * [10.0, -10.0, 0.0],
        "error_mean": [1.0, 3.0, 2.0, *3 * [math.nan]],
        "error_band": 0.5,
    }
)
LINES = assign_lines(labels_of("a", "b", "c"))


def test_a_line_has_the_means_in_order_of_x_with_their_interval_and_the_style_of_its_estimator():
    a, b = line_series(SUMMARY, LINES, "snr_db", "error_mean", "error")
    assert (list(a.x), list(a.y)) == ([-10, 0, 10], [3, 2, 1])
    assert (list(a.low), list(a.high)) == ([2.5, 1.5, 0.5], [3.5, 2.5, 1.5])
    assert a.style == LINES["a", "{}"].style
    assert (a.label, b.label) == ("a", "b: no score")
    (plain, _) = line_series(SUMMARY, LINES, "snr_db", "error_mean")
    assert (len(plain.low), len(plain.high)) == (0, 0)
    ends = SUMMARY.assign(low_low=0.0, low_high=9.0)
    assert list(line_series(ends, LINES, "snr_db", "error_mean", "low")[0].high) == [9, 9, 9]


def test_at_a_single_snr_estimators_stand_side_by_side_and_references_are_level_lines():
    single = SUMMARY[SUMMARY["snr_db"] == 0]
    found = line_series(single, LINES, "snr_db", "error_mean")
    assert [one.x.item() for one in found] == pytest.approx([-0.1, 0.0])
    a, b = line_series(single, assign_lines(labels_of("a", "b"), ["a"]), "snr_db", "error_mean", "error")
    assert b.x.item() == 0.0
    assert (a.tick, b.tick) == (0.0, 0.0)
    assert (list(a.x), list(a.y), list(a.low)) == ([-0.1, 0.1], [2.0, 2.0], [1.5, 1.5])
    distance = single.rename(columns={"snr_db": "distance"})  # of what is no SNR all stand at the place
    assert [one.x.item() for one in line_series(distance, LINES, "distance", "error_mean")] == [0, 0]


def test_a_huge_band_does_not_dwarf_the_means_and_all_means_are_within():
    low, high = linear_limits(SUMMARY.assign(error_band=1e3), "error_mean", "error")
    assert low < 0
    assert high == pytest.approx(1.06 * 1.5 * 3.0)
    assert linear_limits(SUMMARY, "error_mean", "error")[1] == pytest.approx(1.06 * 3.5)
    assert linear_limits(SUMMARY.assign(error_mean=math.nan), "error_mean", "error")[1] > 0


@given(st.lists(st.floats(1e-9, 1e9), min_size=1))
def test_decades_are_whole_and_hold_all_values(values):
    low, high = decades(pd.Series([*values, 0.0, math.nan]))
    assert low < min(values) <= max(values) < high
    assert np.log10([low, high]) == pytest.approx(np.log10([low, high]).round())


def test_a_column_writes_numbers_scaled_and_leaves_what_is_missing_empty():
    row = {"time_s": 0.01234, "none": None, "nan": math.nan, "text": "time", ("a", "1"): {"n": 3}}
    milliseconds = Column("time [ms]", "time_s", "{:.1f}", scale=1e3)
    assert milliseconds.text(row) == "12.3"
    assert Column("time", "text", "{:.1f}", scale=1e3).text(row) == "time"
    assert [Column("", key, "{:.1f}").text(row) for key in ("none", "nan", "missing")] == ["", "", ""]
    assert Column("", ("a", "1"), lambda entry: f"n{entry['n']}").text(row) == "n3"
    assert Column("", form=lambda whole: str(len(whole))).text(row) == "5"


def test_a_table_has_the_texts_of_its_rows_whether_a_frame_or_mappings():
    columns = [Column("SNR", "snr_db", "{:g}"), Column("error", "error_mean", "{:.1f}")]
    rows = SUMMARY[1:4]
    expected = [["-10", "3.0"], ["0", "2.0"], ["10", ""]]
    for made in (Table("t", columns, rows), Table("t", columns, rows.to_dict("records"))):
        assert (made.headings, made.texts) == (["SNR", "error"], expected)
    assert text_table("t", ["SNR", "error"], expected).texts == expected


def test_rows_of_a_summary_are_spread_over_columns():
    spread = spread_rows(SUMMARY, ["snr_db"], ["estimator", "params"])
    assert [row["snr_db"] for row in spread] == [10, -10, 0]
    for row in spread:
        for name in "ab":
            expected = rows_of(SUMMARY, (name, "{}")).set_index("snr_db").loc[row["snr_db"]]
            assert row[name, "{}"]["error_mean"] == pytest.approx(expected["error_mean"], nan_ok=True)
