"""Comparison as files for continuous integration: Markdown, and JUnit XML with a test for each curve."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import TYPE_CHECKING

from isacbench.charts import text_table
from isacbench.files.escaping import counted, in_markdown, shortened, visible
from isacbench.report.comparisons.comparison_tables import (
    cell_lines,
    change_cells,
    changed_cells,
    compared_rows,
    comparison_grids,
    comparison_lines,
    effect_lines,
    outcome_counts,
    scene_lines,
    verdict_text,
    win_text,
)
from isacbench.report.comparisons.words import Wording
from isacbench.report.tables import markdown

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd

    from isacbench.bench.compare.comparison import Comparison
    from isacbench.bench.compare.verdicts import Tolerance

MAX_CHARACTERS = 60_000
"""Characters of a Markdown file; a comment on GitHub takes 65 536."""

MAX_LINE = 600
"""Characters of a line or a cell in Markdown."""


def comparison_markdown(comparison: Comparison) -> str:
    """Write a comparison as Markdown of bounded length.

    Returns
    -------
    str
        The verdict first, then the counts, what was compared, a table of
        curves and one of changed points for each score, cells and notes, as
        far as they fit.
    """
    said = Wording(comparison)
    lines = [
        *_head(said.outcome),
        _line(outcome_counts(comparison)),
        "",
        *_items([*said.heading, *effect_lines(comparison)]),
        "",
    ]
    for table in comparison_grids(comparison):
        bounded = [[shortened(text, MAX_LINE) for text in row] for row in table.texts]
        lines += markdown(text_table(table.title, table.headings, bounded)).split("\n")
    return _bounded(lines + _items(comparison_lines(comparison)))


def incomparable_markdown(base: str, new: str, reasons: Sequence[str]) -> str:
    """Write that two runs cannot be compared, with all reasons.

    Parameters
    ----------
    base, new : str
        Folders of the runs.
    """
    return _bounded([*_head("not comparable"), *_items([f"base {base}", f"new {new}", *reasons])])


def comparison_junit(comparison: Comparison) -> str:
    """Write a comparison as JUnit XML.

    Returns
    -------
    str
        A suite for each score and scenario, with a case for each curve and each
        changed point, which fails where it is a regression; and a suite of
        cells, whose cases fail where cells or scores failed or are missing.
    """
    said = Wording(comparison)
    root = _root()
    for tolerance in comparison.tolerances:
        curves, changed = compared_rows(comparison, tolerance)
        for scenario in dict.fromkeys(curves["scenario"]):
            suite = _suite(root, f"{tolerance}: {scenario}")
            for table in (curves, changed):
                _add_rows(suite, table[table["scenario"] == scenario], tolerance, said)
    suite, kind = _suite(root, "cells"), said.verdict("regression")
    for cells, what in changed_cells(comparison, said)[:2]:
        text = "".join(cell_lines(cells, what, said))
        _add_case(suite, f"no cells {what}", text, "failure" if text else "", kind)
    n_lost, what = comparison.n_lost_scores, f"missing in {said.sides[1]}"
    text = f"{counted(n_lost, 'score')} {what}" if n_lost else ""
    _add_case(suite, f"no scores {what}", text, "failure" if text else "", kind)
    return _xml(root, [*said.heading, *comparison_lines(comparison), *scene_lines(comparison)])


def incomparable_junit(base: str, new: str, reasons: Sequence[str]) -> str:
    """Write that two runs cannot be compared: a case with an error for each reason.

    Parameters
    ----------
    base, new : str
        Folders of the runs.
    """
    root = _root()
    suite = _suite(root, "comparable")
    for reason in reasons:
        _add_case(suite, reason, reason, "error", "not comparable")
    return _xml(root, [f"base {base}", f"new {new}"])


def _head(outcome: str) -> list[str]:
    return [f"### isacbench compare: {_line(outcome)}", ""]


def _items(texts: Sequence[str]) -> list[str]:
    return [f"- {_line(text)}" for text in texts]


def _line(text: str) -> str:
    return in_markdown(shortened(text, MAX_LINE))


def _bounded(lines: Sequence[str]) -> str:
    """Join the lines that fit."""
    kept, room = [], MAX_CHARACTERS
    for line in lines:
        room -= len(line) + 1
        if room < 0:
            kept += ["", "The rest is left out: it is too long. `isacbench compare --json` has all of it."]
            break
        kept.append(line)
    return "\n".join(kept) + "\n"


def _root() -> ET.Element:
    return ET.Element("testsuites", name="isacbench compare")


def _suite(root: ET.Element, name: str) -> ET.Element:
    return ET.SubElement(root, "testsuite", name=visible(name))


def _add_rows(suite: ET.Element, table: pd.DataFrame, tolerance: Tolerance, said: Wording) -> None:
    """Add a case for each curve or point."""
    unit = " %" if tolerance.is_relative else ""
    for row in table.to_dict("records"):
        base, new, change, interval, p_value = change_cells(row, tolerance)
        numbers = [f"{said.heads[0]} {base}", f"{said.heads[1]} {new}", f"change {change}{unit}"]
        numbers += [f"95 % interval {interval}{unit}"] if interval else []
        numbers += [f"p {p_value}", counted(row["n_pairs"], said.unit)]
        numbers += (
            [f"probability that {said.heads[1]} is better {win_text(row)}"] if said.unit == "scene" else []
        )
        place = f"at {row['snr_db']:g} dB" if "snr_db" in row else "whole curve"
        outcome = f"{verdict_text(row, tolerance, said)}; {', '.join(numbers)}"
        problem = "failure" if row["verdict"] == "regression" else ""
        _add_case(suite, f"{said.name(row, after=', ')}{place}", outcome, problem, said.verdict("regression"))


def _add_case(suite: ET.Element, name: str, text: str, problem: str, kind: str) -> None:
    """Add a case with its text: its output, or the message of a problem of some kind."""
    case = ET.SubElement(suite, "testcase", classname=suite.attrib["name"], name=visible(name))
    if problem:
        ET.SubElement(case, problem, type=kind, message=visible(text)).text = visible(text)
    elif text:
        ET.SubElement(case, "system-out").text = visible(text)


def _xml(root: ET.Element, lines: Sequence[str]) -> str:
    """Count cases, failures and errors, append the lines, and write it all."""
    for element in (*root, root):
        for name, tag in (("tests", "testcase"), ("failures", "failure"), ("errors", "error")):
            element.set(name, str(len(element.findall(f".//{tag}"))))
    ET.SubElement(root[-1], "system-out").text = "\n".join(map(visible, lines))
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'
