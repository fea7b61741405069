import dataclasses
from xml.etree import ElementTree

from isacbench.report.comparison import (
    MAX_CHARACTERS,
    comparison_junit,
    comparison_markdown,
    incomparable_junit,
    incomparable_markdown,
)

HOSTILE = "<b>&\x00\x1b[31m\uffff]]>|`x`\nnext"


def worse_at_10_db(records):
    chosen = (records["estimator"] == "nomp4d") & (records["snr_db"] == 10)
    records.loc[chosen, "deviation"] *= 1.5
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


def test_a_case_is_a_curve_a_changed_point_or_lost_cells_and_fails_where_it_is_worse(compared):
    found = cases(comparison_junit(compared(worse_at_10_db, trials=12)))
    suite = "deviation=5%: street"
    point = found.pop(f"{suite}: nomp4d, at 10 dB")
    assert point[0] == "failure"
    assert point[1].startswith("regression; base 8.403, new 12.6, change [%] +50, 95 % interval +50 to +50")
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


def test_numbers_of_cases_and_failures_are_those_of_the_file(compared):
    suites = ElementTree.fromstring(comparison_junit(compared(worse_at_10_db, trials=12)).encode())
    for element in (suites, *suites):
        assert int(element.attrib["tests"]) == len(list(element.iter("testcase")))
        assert int(element.attrib["failures"]) == len(list(element.iter("failure")))
    assert int(suites.attrib["failures"]) >= 2


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
    lines = comparison_markdown(compared(worse_at_10_db, trials=12)).splitlines()
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
