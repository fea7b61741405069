"""Comparison as files for continuous integration: Markdown, and JUnit XML with a test for each curve."""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from itertools import chain

from isacbench.bench.compare.comparison import Comparison
from isacbench.bench.compare.verdicts import Tolerance
from isacbench.charts import text_table
from isacbench.files.escaping import counted, in_markdown, shortened, visible
from isacbench.report.comparison import ComparisonReport, Row
from isacbench.report.tables import markdown

MAX_CHARACTERS = 60_000
"""Characters of a Markdown file; a comment on GitHub takes 65 536."""

MAX_LINE = 600
"""Characters of a line or a cell in Markdown."""


def comparison_markdown(comparison: Comparison) -> str:
    """Write a comparison as Markdown of bounded length.

    The verdict comes first, then the counts, what was compared, a table of curves and one of changed points
    for each score, cells and notes, as far as they fit.
    """
    report = ComparisonReport(comparison)
    lines = [_line(report.counts()), "", *_items([*report.heading, *report.effect_lines()]), ""]
    for table in report.grids():
        bounded = [[shortened(text, MAX_LINE) for text in row] for row in table.texts]
        lines += markdown(text_table(table.title, table.headings, bounded)).split("\n")
    return _markdown(report.outcome, lines + _items(report.lines()))


def incomparable_markdown(base: str, new: str, reasons: Sequence[str]) -> str:
    """Write that two runs, given by their folders, cannot be compared, with all reasons."""
    return _markdown("not comparable", _items([f"base {base}", f"new {new}", *reasons]))


def _items(texts: Sequence[str]) -> list[str]:
    return [f"- {_line(text)}" for text in texts]


def _line(text: str) -> str:
    return in_markdown(shortened(text, MAX_LINE))


def _markdown(outcome: str, lines: Sequence[str]) -> str:
    """Join the lines that fit, below a heading."""
    kept, room = [], MAX_CHARACTERS
    for line in (f"### isacbench compare: {_line(outcome)}", "", *lines):
        room -= len(line) + 1
        if room < 0:
            kept += ["", "The rest is left out: it is too long. `isacbench compare --json` has all of it."]
            break
        kept.append(line)
    return "\n".join(kept) + "\n"


def comparison_junit(comparison: Comparison) -> str:
    """Write a comparison as JUnit XML.

    It has a suite for each score and scenario, with a case for each curve and each changed point, which
    fails where it is a regression; and a suite of cells, whose cases fail where cells or scores failed or
    are missing.
    """
    report, root = ComparisonReport(comparison), ET.Element("testsuites", name="isacbench compare")
    worse = report.verdict("regression")
    for tolerance in comparison.tolerances:
        curves, changed = report.compared_rows(tolerance)
        for scenario in dict.fromkeys(curves["scenario"]):
            for row in chain.from_iterable(
                table[table["scenario"] == scenario].to_dict("records") for table in (curves, changed)
            ):
                place = f"at {row['snr_db']:g} dB" if "snr_db" in row else "whole curve"
                name = f"{report.name(row, after=', ')}{place}"
                problem = "failure" if row["verdict"] == "regression" else ""
                text = _outcome(row, tolerance, report)
                _add_case(root, f"{tolerance}: {scenario}", name, text, problem, worse)
    lost = [
        (f"cells {what}", report.cell_line(cells, what) if len(cells) else "") for cells, what in report.lost
    ]
    what = f"missing in {report.sides[1]}"
    n_lost = comparison.n_lost_scores
    lost.append((f"scores {what}", f"{counted(n_lost, 'score')} {what}" if n_lost else ""))
    for name, text in lost:
        _add_case(root, "cells", f"no {name}", text, "failure" if text else "", worse)
    return _xml(root, [*report.heading, *report.lines(), *report.scene_lines()])


def incomparable_junit(base: str, new: str, reasons: Sequence[str]) -> str:
    """Write that two runs, given by their folders, cannot be compared: an error for each reason."""
    root = ET.Element("testsuites", name="isacbench compare")
    for reason in reasons:
        _add_case(root, "comparable", reason, reason, "error", "not comparable")
    return _xml(root, [f"base {base}", f"new {new}"])


def _outcome(row: Row, tolerance: Tolerance, report: ComparisonReport) -> str:
    """Verdict and numbers of a curve or point in a sentence."""
    texts = {column.heading: column.text(row) for column in report.number_columns(tolerance)}
    verdict = texts.pop("verdict")
    parts = [f"{heading} {text}" for heading, text in texts.items() if text]
    return f"{verdict}; {', '.join([*parts, counted(row['n_pairs'], report.unit)])}"


def _add_case(root: ET.Element, suite: str, name: str, text: str, problem: str, kind: str) -> None:
    """Add a test case to the last suite, or to a new one.

    Its text is its output, or the message of a problem, a failure or an error, of a kind.
    """
    suite, text = visible(suite), visible(text)
    if not len(root) or root[-1].get("name") != suite:
        ET.SubElement(root, "testsuite", name=suite)
    case = ET.SubElement(root[-1], "testcase", classname=suite, name=visible(name))
    if problem:
        ET.SubElement(case, problem, type=kind, message=text).text = text
    elif text:
        ET.SubElement(case, "system-out").text = text


def _xml(root: ET.Element, lines: Sequence[str]) -> str:
    """Write suites of cases with their numbers, and lines as the output of the last suite."""
    for element in (*root, root):
        for name, tag in (("tests", "testcase"), ("failures", "failure"), ("errors", "error")):
            element.set(name, str(len(element.findall(f".//{tag}"))))
    ET.SubElement(root[-1], "system-out").text = "\n".join(map(visible, lines))
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'
