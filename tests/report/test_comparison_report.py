"""Comparisons of made-up runs in words, tables, charts, JSON, Markdown and JUnit XML."""

import copy
import dataclasses
import json
from xml.etree import ElementTree

import numpy as np
import pytest

from isacbench.bench.compare.comparison import compare_tables, parse_tolerance
from isacbench.bench.store.run import Run
from isacbench.errors import InputError
from isacbench.report.comparison import (
    MAX_CHARACTERS,
    ComparisonReport,
    comparison_junit,
    comparison_markdown,
    incomparable_junit,
    incomparable_markdown,
)

HOSTILE = "<b>&\x00\x1b[31m\uffff]]>|`x`\nnext"


@pytest.fixture
def compared(made_run):
    """Return a function that compares a made-up run with a changed one, or its two estimators."""

    def make(change=lambda records: None, tolerances=(), is_between=False, **options):
        records, manifest = made_run(**{"estimators": ("blob", "nomp4d"), **options})
        changed = records.copy()
        change(changed)
        base, new = Run("base", records, manifest), Run("new", changed, copy.deepcopy(manifest))
        if is_between:
            return compare_tables(new, new, partners={("blob", "{}"): ("nomp4d", "{}")}, is_between=True)
        return compare_tables(base, new, map(parse_tolerance, tolerances))

    return make


def worse_at_10_db(records):
    chosen = (records["estimator"] == "nomp4d") & (records["snr_db"] == 10)
    records.loc[chosen, "deviation"] *= 1.3


def failing(records):
    records.loc[:4, ["status", "reason"]] = ["timeout", "TimeoutError: 9 s"]


def scoreless(records):
    records["deviation"] = np.nan


def test_every_curve_has_a_row_and_only_changed_points_are_listed(compared):
    curves, points = ComparisonReport(compared(worse_at_10_db, trials=12)).tables()
    assert [row[0] for row in curves.texts] == ["street, blob", "street, nomp4d"]
    (row,) = points.texts
    assert dict(zip(points.headings, row, strict=True)) | {"p": "", "95 % interval": ""} == {
        "curve": "street, nomp4d",
        "SNR [dB]": "10",
        "trials": "12",
        "base": row[3],
        "new": row[4],
        "change [%]": "+30",
        "95 % interval": "",
        "p": "",
        "verdict": "regression",
    }
    assert float(row[4]) == pytest.approx(1.3 * float(row[3]), rel=1e-3)


def test_nothing_changed_is_one_table_of_curves(compared):
    (table,) = ComparisonReport(compared()).tables()
    assert [row[-1] for row in table.texts] == ["same", "same"]
    assert [row[4] for row in table.texts] == ["0", "0"]


def test_an_inconclusive_curve_says_what_it_would_take(compared):
    few = ComparisonReport(compared(worse_at_10_db, trials=2)).tables()[0]
    assert few.texts[1][-1] == "inconclusive: needs 8 trials"
    assert few.texts[1][5] == ""

    def noisy(records):
        records["deviation"] *= 1 + np.random.default_rng(0).normal(0, 0.5, len(records))

    relative = ComparisonReport(compared(noisy, trials=12)).tables()[0]
    shown = relative.texts[0][-1]
    assert shown.startswith("inconclusive: shows ")
    assert shown.endswith(" %")
    absolute = ComparisonReport(compared(noisy, ["deviation=0.1"], trials=12)).tables()[0]
    assert absolute.headings[4] == "change"
    assert not absolute.texts[0][-1].endswith("%")


def test_of_many_curves_the_worst_are_shown_and_the_others_counted(compared):
    names = [f"e{n:02d}" for n in range(60)]

    def change(records):
        records.loc[records["estimator"] == "e55", "deviation"] *= 1.5

    curves = ComparisonReport(compared(change, estimators=names)).tables()[0]
    assert len(curves.texts) == 40
    assert curves.texts[0][0] == "street, e55"
    assert curves.title.endswith("(20 same more not shown)")


def test_failures_missing_and_repaired_cells_are_counted_and_the_first_named(compared):
    (line,) = ComparisonReport(compared(failing)).lines()
    assert line.startswith(
        "5 cells failed in the new run alone: blob on street at -20 dB, trial 0 (timeout: TimeoutError: 9 s)"
    )
    assert line.endswith("; ...")

    def renumber(records):
        records.loc[0, "trial"] = 99

    assert ComparisonReport(compared(renumber)).lines() == [
        "1 cell missing in the new run: blob on street at -20 dB, trial 0",
        "1 cell missing in the base: blob on street at -20 dB, trial 99",
    ]


def test_the_summary_is_one_line_with_all_counts(compared):
    assert ComparisonReport(compared()).summary() == "no regression: of 2 curves 2 same; of 6 points 6 same"
    summary = ComparisonReport(compared(failing)).summary()
    assert summary.startswith("no regression, but results are missing: of 2 curves")
    assert summary.endswith("5 cells failed in the new run alone")

    assert "inconclusive" in ComparisonReport(compared(scoreless)).summary()


def test_the_content_is_json_without_infinities(compared):
    content = ComparisonReport(compared(worse_at_10_db, trials=2)).content()
    again = json.loads(json.dumps(content, allow_nan=False))
    assert again == content
    assert content["comparable"]
    assert not content["regression"]
    assert len(content["points"]) == 6
    (point,) = (row for row in content["points"] if row["verdict"] == "inconclusive")
    assert point["smallest_effect"] is None
    assert point["relative"] == pytest.approx(0.3)


def charts_of(comparison):
    """Title of the group of a comparison's charts, and its charts."""
    group = ComparisonReport(comparison).charts("deviation")
    return group.title, group.charts


def test_a_chart_has_both_curves_and_a_ring_where_they_part(compared):
    title, (calm, worse) = charts_of(compared(worse_at_10_db, trials=12))
    assert title == "deviation of paired cells: mean of 12 trials, 95 % confidence band"
    assert worse.title.startswith("street, nomp4d\nwhole curve: regression (+")
    base, new, ring = worse.series
    assert list(base.x) == list(new.x) == [-20, -5, 10]
    np.testing.assert_allclose(np.divide(new.y, base.y), [1, 1, 1.3])
    assert (list(ring.x), list(ring.y), ring.style.symbol) == ([10], [new.y.iloc[-1]], "circle-open")
    legend = ["base: 0.1.0 (0123456789)", "new: 0.1.0 (0123456789)", "regression"]
    assert [one.label for one in worse.series] == legend
    assert calm.title == "street, blob\nwhole curve: same"
    assert len(calm.series) == 2


def test_a_chart_of_a_pair_is_headed_by_both_and_of_two_estimators_the_legend_names_them(compared, made_run):
    records, manifest = made_run(trials=12, estimators=("blob", "nomp4d"))
    run, partners = Run("run", records, manifest), {("blob", "{}"): ("nomp4d", "{}")}
    _, (chart,) = charts_of(compare_tables(run, run, partners=partners))
    assert chart.title.startswith("street, blob → nomp4d\nwhole curve: regression (+")
    _, (chart,) = charts_of(compared(trials=12, is_between=True))
    assert chart.title.startswith("street\nwhole curve: worse (+")
    assert [one.label for one in chart.series] == ["A: blob", "B: nomp4d", "worse"]


def test_the_axis_holds_all_means_and_does_not_blow_up_what_hardly_varies(compared):
    for chart in charts_of(compared(trials=1))[1]:
        low, high = chart.y.limits
        means = np.concatenate([one.y for one in chart.series])
        assert low < means.min() <= means.max() < high
        assert high - low >= 0.2 * means.max()


def test_fewer_than_five_pairs_have_no_band_and_the_title_says_so(compared):
    title, charts = charts_of(compared(trials=4))
    assert title == "deviation of paired cells: mean of 4 trials, no confidence band below 5"
    assert {chart.y.title for chart in charts} == {"imaging deviation"}
    assert all(np.isnan([*one.low, *one.high]).all() for chart in charts for one in chart.series)


def test_of_many_curves_those_with_a_regression_are_drawn_first_and_long_names_are_shortened(
    compared, monkeypatch
):
    monkeypatch.setattr("isacbench.report.comparison.MOST_CHARTS", 6)
    names = [f"nomp4d_with_a_{'very_' * 9}long_name_{n:02d}" for n in range(8)]

    def change(records):
        chosen = (records["estimator"] == names[-1]) & (records["snr_db"] == 10)
        records.loc[chosen, "deviation"] *= 1.5

    title, charts = charts_of(compared(change, estimators=names, trials=12))
    assert len(charts) == 6
    name, outcome = charts[0].title.split("\n")
    assert (name[:20], name[-7:]) == (f"street, {names[-1][:12]}", "name_07")
    assert outcome.startswith("whole curve: ")
    assert title.endswith(", 6 of 8 curves")


def test_of_many_curves_one_that_is_the_same_but_has_a_worse_point_is_drawn_first(compared, monkeypatch):
    monkeypatch.setattr("isacbench.report.comparison.MOST_CHARTS", 2)
    names = list("abcd")

    def change(records):
        own = records["estimator"] == names[-1]
        records["deviation"] += np.where(own, records["snr_db"].map({10: 5.0, -20: -5.0}).fillna(0.0), 0.0)

    charts = charts_of(compared(change, estimators=names, trials=12))[1]
    assert [chart.title.split("\n")[0] for chart in charts] == ["street, d", "street, a"]


def test_a_figure_for_each_score_lies_beside_the_new_run_or_where_asked(compared, tmp_path):
    found = compared(tolerances=["recall=0.1"])
    paths = ComparisonReport(found).draw(tmp_path)
    assert paths == [tmp_path / "figures" / f"compare-{name}.png" for name in ("deviation", "recall")]
    assert all(path.stat().st_size > 10_000 for path in paths)
    asked = ComparisonReport(found).paths(tmp_path, tmp_path / "my.svg")
    assert list(asked.values()) == [tmp_path / "my.svg", tmp_path / "my-recall.svg"]
    with pytest.raises(InputError, match=r"a picture takes the extension \.png"):
        ComparisonReport(found).paths(tmp_path, tmp_path / "my.txt")


def test_without_a_pair_nothing_is_drawn(compared, tmp_path):
    assert ComparisonReport(compared(scoreless)).draw(tmp_path) == []


def test_a_figure_that_cannot_be_written_is_told(compared, tmp_path):
    (tmp_path / "figures").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        ComparisonReport(compared()).draw(tmp_path)


def worse_and_failing(records):
    worse_at_10_db(records)
    records.loc[:1, ["status", "reason"]] = ["error", "ValueError: no"]


def cases(text):
    """Names of all cases of a JUnit file, each with the tag and the message of its problem."""
    return {
        f"{suite.attrib['name']}: {case.attrib['name']}": next(
            ((problem.tag, problem.attrib["message"]) for problem in case if problem.tag != "system-out"),
            None,
        )
        for suite in ElementTree.fromstring(text.encode())
        for case in suite.iter("testcase")
    }


def test_a_case_is_a_curve_a_changed_point_or_lost_cells_and_fails_where_it_is_worse_and_is_counted(compared):
    text = comparison_junit(compared(worse_and_failing, trials=12))
    suites, found = ElementTree.fromstring(text.encode()), cases(text)
    for element in (suites, *suites):
        assert int(element.attrib["tests"]) == len(list(element.iter("testcase")))
        assert int(element.attrib["failures"]) == len(list(element.iter("failure")))
    suite = "deviation=5%: street"
    point = found.pop(f"{suite}: nomp4d, at 10 dB")
    assert point[0] == "failure"
    assert point[1].startswith("regression; base 8.403, new 10.92, change [%] +30, 95 % interval +30 to +30")
    assert found.pop(f"{suite}: nomp4d, whole curve")[0] == "failure"
    tag, message = found.pop("cells: no cells failed in the new run alone")
    assert tag == "failure"
    assert message.startswith(
        "2 cells failed in the new run alone: blob on street at -20 dB, trial 0 (error: ValueError: no)"
    )
    assert found == dict.fromkeys(
        [
            f"{suite}: blob, whole curve",
            "cells: no cells missing in the new run",
            "cells: no scores missing in the new run",
        ]
    )


def test_of_two_estimators_cases_and_tables_say_worse_and_better(compared):
    found = compared(is_between=True, trials=12)
    curve = cases(comparison_junit(found))["deviation=5%: street: whole curve"]
    assert curve[1].startswith("worse; A ")
    text = comparison_markdown(found)
    assert text.startswith("### isacbench compare: nomp4d is worse than blob\n")
    assert "| curve | trials | A | B |" in text
    assert "\n- A blob\n- B nomp4d\n" in text
    assert "regression" not in text + comparison_junit(found)


def test_any_text_makes_valid_xml_and_harmless_markdown(compared):
    def change(records):
        records.loc[0, ["status", "reason"]] = ["error", HOSTILE]

    found = compared(change, trials=12, scenarios=(HOSTILE,), estimators=("nomp4d", HOSTILE))
    xml, text = comparison_junit(found), comparison_markdown(found)
    assert any(r"<b>&\x00\x1b[31m" in name for name in cases(xml))
    halved = f"{HOSTILE}\ud800"
    assert cases(incomparable_junit(halved, "new", [halved]))
    for made in (text, incomparable_markdown(halved, "new", [halved])):
        assert "<b>" not in made
        assert "\x1b" not in made
        assert r"&lt;b>&amp;\\x00\\x1b[31m\\uffff]]>\|\`x\`\\nnext" in made
        made.encode()


def test_markdown_begins_with_the_verdict_and_has_tables_cells_and_notes(compared):
    lines = comparison_markdown(compared(worse_and_failing, trials=12)).splitlines()
    assert lines[0] == "### isacbench compare: regression"
    assert lines[2].startswith("of 2 curves ")
    assert "- new new: isacbench 0.1.0 (0123456789)" in [" ".join(line.split()) for line in lines]
    assert "**deviation=5%: points that changed**" in lines
    assert lines[-1].startswith("- 2 cells failed in the new run alone: blob on street at -20 dB")


def test_markdown_fits_into_a_comment_and_says_that_something_is_left_out(compared):
    text = comparison_markdown(dataclasses.replace(compared(trials=12), notes=("x" * 10_000,) * 200))
    assert MAX_CHARACTERS - 2000 < len(text) <= 65_536
    assert text.startswith("### isacbench compare: no regression\n")
    assert text.endswith("`isacbench compare --json` has all of it.\n")


def test_what_cannot_be_compared_is_an_error_for_each_reason():
    found = cases(incomparable_junit("base", "new", ["the seed differs", "the suite differs"]))
    assert [problem[0] for problem in found.values()] == ["error", "error"]
    text = incomparable_markdown("base", "new", ["the seed differs"])
    assert text == "### isacbench compare: not comparable\n\n- base base\n- new new\n- the seed differs\n"
