"""Comparison as JUnit XML, which continuous integration shows as tests: one a curve or changed point."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import TYPE_CHECKING, Any

from isacbench.files.escaping import counted, visible
from isacbench.report.comparisons.comparison_tables import (
    cell_lines,
    change_cells,
    comparison_lines,
    verdict_text,
)
from isacbench.report.comparisons.words import wording

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping, Sequence

    import pandas as pd

    from isacbench.bench.compare.comparison import Comparison
    from isacbench.bench.compare.tolerance import Tolerance
    from isacbench.report.comparisons.words import Wording

NAME = "isacbench compare"
CHANGED = ("regression", "improvement")


def comparison_junit(comparison: Comparison) -> str:
    """Write a comparison as JUnit XML.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    str
        A suite for each score and scenario, with a case for each curve and each
        changed point, which fails where it is a regression; and a suite of
        cells, whose cases fail where cells or scores failed or are missing.
    """
    said = wording(comparison)
    root = ET.Element("testsuites", name=NAME)
    for tolerance in comparison.tolerances:
        curves = comparison.curves[comparison.curves["metric"] == tolerance.metric]
        points = comparison.points[comparison.points["metric"] == tolerance.metric]
        changed = points[(points["n_snr"] > 1) & points["verdict"].isin(CHANGED)]
        for scenario in dict.fromkeys(curves["scenario"]):
            suite = _suite(root, f"{tolerance}: {scenario}")
            for table in (curves, changed):
                _add_rows(suite, table[table["scenario"] == scenario], tolerance, said)
    _add_cells(_suite(root, "cells"), comparison, said)
    return _text(root, [*said.heading, *comparison_lines(comparison)])


def incomparable_junit(base: str, new: str, reasons: Sequence[str]) -> str:
    """Write that two runs cannot be compared: a case with an error for each reason.

    Parameters
    ----------
    base, new : str
        Folders of the runs.
    reasons : sequence of str

    Returns
    -------
    str
    """
    root = ET.Element("testsuites", name=NAME)
    suite = _suite(root, "comparable")
    for reason in reasons:
        _add_case(suite, reason, problem=("error", "not comparable", reason))
    return _text(root, [f"base {base}", f"new {new}"])


def _suite(root: ET.Element, name: str) -> ET.Element:
    return ET.SubElement(root, "testsuite", name=visible(name))


def _add_rows(suite: ET.Element, table: pd.DataFrame, tolerance: Tolerance, said: Wording) -> None:
    """Add a case for each curve or point."""
    for row in table.to_dict("records"):
        place = f"at {row['snr_db']:g} dB" if "snr_db" in row else "whole curve"
        outcome = f"{verdict_text(row, tolerance, said)}; {_numbers(row, tolerance, said)}"
        is_worse = row["verdict"] == "regression"
        problem = ("failure", said.words.regression, outcome) if is_worse else None
        _add_case(suite, f"{said.name(row, after=', ')}{place}", outcome, problem)


def _numbers(row: Mapping[Hashable, Any], tolerance: Tolerance, said: Wording) -> str:
    """Write the numbers of a curve or point in words."""
    base, new, change, interval, p_value = change_cells(row, tolerance)
    unit = " %" if tolerance.is_relative else ""
    return ", ".join(
        [
            f"{said.words.base} {base}",
            f"{said.words.new} {new}",
            f"change {change}{unit}",
            *([f"95 % interval {interval}{unit}"] if interval else []),
            f"p {p_value}",
            counted(row["n_pairs"], "trial"),
        ]
    )


def _add_cells(suite: ET.Element, comparison: Comparison, said: Wording) -> None:
    """Add a case for each way in which cells and scores are lost."""
    cells, words = comparison.cells, said.words
    lost = []
    if comparison.n_lost_scores:
        lost.append(f"{counted(comparison.n_lost_scores, 'score')} {words.lost}")
    for name, lines in (
        (f"no cells {words.failed}", cell_lines(cells.new_failures, words.failed, said)),
        (f"no cells {words.missing}", cell_lines(cells.missing, words.missing, said)),
        (f"no scores {words.lost}", lost),
    ):
        _add_case(suite, name, problem=("failure", words.regression, lines[0]) if lines else None)


def _add_case(
    suite: ET.Element, name: str, output: str = "", problem: tuple[str, str, str] | None = None
) -> None:
    """Add a case with what it has to say, or with a problem: a failure or an error, its type and message."""
    case = ET.SubElement(suite, "testcase", classname=suite.attrib["name"], name=visible(name))
    if problem is not None:
        tag, kind, message = map(visible, problem)
        ET.SubElement(case, tag, type=kind, message=message).text = message
    elif output:
        ET.SubElement(case, "system-out").text = visible(output)


def _text(root: ET.Element, lines: Sequence[str]) -> str:
    """Count cases, failures and errors, append the lines, and write it all."""
    for element in (*root, root):
        for name, tag in (("tests", "testcase"), ("failures", "failure"), ("errors", "error")):
            element.set(name, str(sum(1 for _ in element.iter(tag))))
    ET.SubElement(root[-1], "system-out").text = "\n".join(map(visible, lines))
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'
