"""A comparison in words, tables, charts and JSON; for continuous integration in Markdown and JUnit XML."""

import dataclasses
import math
import xml.etree.ElementTree as ET
from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from isacbench import charts
from isacbench.bench.compare.comparison import VERDICTS, Comparison, Tolerance, verdict_counts
from isacbench.bench.compare.pairs import CURVE
from isacbench.bench.kinds.scores import score_of
from isacbench.bench.labels import estimator_labels
from isacbench.bench.statistics import trials_and_band
from isacbench.charts import Axis, Chart, ChartGroup, Column, LineStyle, Series, Table, text_table
from isacbench.files.checked_files import make_own_folder, require_picture
from isacbench.files.escaping import escape_control, file_stems, in_markdown, plural, shortened
from isacbench.report.figures import FOLDER, draw_charts, save, styled
from isacbench.report.tables import json_rows, markdown, signed

Row = Mapping[Hashable, Any]

MAX_ROWS = 40
"""Rows of a table that somebody reads: of more, the worst verdicts are shown."""

CELLS_NAMED = 3
CELL_TABLES = {"new_failures": "failed", **{name: name for name in ("missing", "repaired", "added")}}
"""Changes of cells by the names of their tables in JSON."""

SCENE_LINE = (
    "the scene is the unit: scores are averaged over its trials, and tests, intervals and probabilities are "
    "over scenes"
)

MAX_CHARACTERS = 60_000
"""Characters of a Markdown file; a comment on GitHub takes 65 536."""

MAX_LINE = 600
"""Characters of a line or a cell in Markdown."""

MOST_CHARTS = 12
LONGEST_TITLE = 80
BASE, NEW = LineStyle("#595959", "dash", "square"), LineStyle("#0072B2", "solid", "circle")
RINGS = {
    "regression": LineStyle("#D55E00", "", "circle-open"),
    "improvement": LineStyle("#009E73", "", "diamond-open"),
}
"""Marks around points of a verdict."""


class ComparisonReport:
    """A comparison in words ("regression" for two runs, "worse" for two estimators), tables, charts, JSON.

    Attributes
    ----------
    comparison : Comparison
    heads, sides, legend : (str, str)
        Names of base and new side at the head of a column, in a sentence, and with what distinguishes them.
    heading : list of str
        Both sides with the version of their code, one line each.
    outcome : str
        Summary in one phrase: the new side is worse, lacks results, or neither.
    labels : mapping of (str, str) to str
        Short names of estimators, by name and parameters.
    unit : {"trial", "scene"}
        Noun for what is paired.
    lost, gained : list of (DataFrame, str)
        Cells that one side alone delivered, base or new, with words for them.
    lost_scores : str
        Number of scores that the new side lacks in words, empty for none.
    """

    def __init__(self, comparison: Comparison) -> None:
        self.comparison = comparison
        full = estimator_labels(comparison.variants)
        self.labels, self._numbers = charts.short_labels(full), charts.number_table(full)
        self._between = comparison.between and [full[variant] for variant in comparison.between]
        self.unit = comparison.unit
        self._verdicts: dict[str, str] = {}
        versions = comparison.base_version, comparison.new_version
        if self._between is None:
            self.heads, self.sides = ("base", "new"), ("the base", "the new run")
            self.legend = f"base: {versions[0]}", f"new: {versions[1]}"
            self.heading = [
                f"base {comparison.base}: isacbench {versions[0]}",
                f"new  {comparison.new}: isacbench {versions[1]}",
            ]
            worse, fine = "regression", "no regression"
        else:
            first, second = self._between
            self.heads = self.sides = "A", "B"
            self.legend = f"A: {first}", f"B: {second}"
            self.heading = [f"A {first}", f"B {second}", f"in {comparison.base}: isacbench {versions[0]}"]
            self._numbers = []
            self._verdicts = {"regression": "worse", "improvement": "better"}
            worse, fine = f"{second} is worse than {first}", _fine(comparison, first, second)
            if comparison.is_better:
                worse += " in one part and better in another"
        lost = ", but results are missing" if comparison.is_regression else ""
        self.outcome = worse if comparison.is_worse else f"{fine}{lost}"
        cells, (base, new) = comparison.changed_cells, self.sides
        self.lost = [(cells("failed"), f"failed in {new} alone"), (cells("missing"), f"missing in {new}")]
        n_lost = comparison.n_lost_scores
        self.lost_scores = f"{plural(n_lost, 'score')} missing in {new}" if n_lost else ""
        self.gained = [(cells("repaired"), f"failed in {base} alone"), (cells("added"), f"missing in {base}")]

    def verdict(self, verdict: str) -> str:
        """Name one of `isacbench.bench.compare.comparison.VERDICTS`."""
        return self._verdicts.get(verdict, verdict)

    def name(self, row: Row, before: str = "", after: str = "") -> str:
        """Name the estimator of a curve, point or cell, or both of a pair, with text around.

        Empty if two estimators are compared, because the heading names them.
        """
        if self._between:
            return ""
        sides = (row["estimator"], row["params"]), (row["new_estimator"], row["new_params"])
        return f"{before}{' → '.join(dict.fromkeys(self.labels[variant] for variant in sides))}{after}"

    def changed_points(self) -> pd.DataFrame:
        """Points that got worse or better, without the point of a curve of one SNR, which is the curve."""
        points = self.comparison.points
        return points[(points["n_snr"] > 1) & points["verdict"].isin(["regression", "improvement"])]

    def compared_rows(self, tolerance: Tolerance) -> tuple[pd.DataFrame, pd.DataFrame]:
        """Choose the curves of a score, and its points that got worse or better."""
        curves, changed = self.comparison.curves, self.changed_points()
        return curves[curves["metric"] == tolerance.metric], changed[changed["metric"] == tolerance.metric]

    def tables(self) -> list[Table]:
        """Lay out every curve and the points that got worse or better, and the scenes that changed most."""
        tables = list(self._numbers)
        for tolerance in self.comparison.tolerances:
            curves, changed = self.compared_rows(tolerance)
            for table, title in ((curves, "curves, means over all SNRs"), (changed, "points that changed")):
                if len(table):
                    tables.append(self._table(f"{tolerance}: {title}", table, tolerance))
        return [*tables, self._scene_table()] if len(self.comparison.scenes) else tables

    def _table(self, title: str, table: pd.DataFrame, tolerance: Tolerance) -> Table:
        """One row a curve or point, the worst verdicts first where they are too many for a screen."""
        if len(table) > MAX_ROWS:
            table = _worst_first(table)
            title += f" ({verdict_counts(table.iloc[MAX_ROWS:], self.verdict)} more not shown)"
        columns = [Column("curve", form=self._place, part=0), Column("SNR [dB]", "snr_db", "{:g}")]
        columns += [Column(f"{self.unit}s", "n_pairs"), *self.number_columns(tolerance)]
        return Table(title, [one for one in columns if one.key in (None, *table)], table.iloc[:MAX_ROWS])

    def _place(self, row: Row) -> str:
        return f"{row['scenario']}{self.name(row, before=', ')}"

    def number_columns(self, tolerance: Tolerance) -> list[Column]:
        """Columns of the numbers of a curve or point, and of its verdict last."""
        name, scale, unit = ("relative", 100.0, " [%]") if tolerance.is_relative else ("change", 1.0, "")

        def interval(row: Row) -> str:
            low, high = row[f"{name}_low"], row[f"{name}_high"]
            return "" if math.isnan(low) else f"{signed(scale * low)} to {signed(scale * high)}"

        def win(row: Row) -> str:
            share = row["win_probability"]
            return "" if math.isnan(share) else f"{share:.2f} ({row['win_low']:.2f} to {row['win_high']:.2f})"

        def p_value(row: Row) -> str:
            least = min(row["p_worse"], row["p_better"])
            return "<0.0001" if least < 1e-4 else f"{least:.2g}"

        columns = [
            Column(self.heads[0], "base_mean", "{:.4g}"),
            Column(self.heads[1], "new_mean", "{:.4g}"),
            Column(f"change{unit}", name, lambda change: signed(scale * change)),
            Column("95 % interval", form=interval),
            Column("p", form=p_value),
            Column(f"P({self.heads[1]} better)", form=win),
            Column("verdict", form=lambda row: self._verdict_text(row, tolerance)),
        ]
        return columns if self.unit == "scene" else [one for one in columns if one.form is not win]

    def _verdict_text(self, row: Row, tolerance: Tolerance) -> str:
        """Write the verdict of a curve or point, if inconclusive with the effect that it could have shown."""
        if row["verdict"] != "inconclusive":
            return self.verdict(row["verdict"])
        if not row["n_pairs"]:
            return "inconclusive: no pairs"
        if not math.isfinite(row["smallest_effect"]):
            return f"inconclusive: needs {row['trials_needed']} {self.unit}s"
        if not tolerance.is_relative:
            return f"inconclusive: shows {row['smallest_effect']:.2g}"
        relative = row["smallest_effect"] / abs(row["base_mean"]) if row["base_mean"] else math.inf
        return f"inconclusive: shows {100 * relative:.2g} %"

    def _scene_table(self) -> Table:
        """One row each scene that changed most."""
        columns = [
            Column("scene", form=self._place, part=0),
            Column("score", "metric"),
            Column(self.heads[0], "base", "{:.4g}"),
            Column(self.heads[1], "new", "{:.4g}"),
            Column("change", "change", signed),
            Column("at SNR [dB]", "snr_db", "{:g}"),
            Column("trial", "trial"),
        ]
        return Table("scenes that changed most", columns, self.comparison.scenes)

    def scene_lines(self) -> list[str]:
        """Write the scenes that changed most, one line each."""
        return [
            f"changed most: {scene}: {score} {base} to {new}; most at {snr_db} dB, trial {trial}"
            for scene, score, base, new, _, snr_db, trial in self._scene_table().texts
        ]

    def effect_lines(self) -> list[str]:
        """Write the effect on each score and pair of estimators: means, change, and where it is better."""
        lines = []
        for tolerance in self.comparison.tolerances:
            curves, _ = self.compared_rows(tolerance)
            keys = ["estimator", "params", "new_estimator", "new_params"]
            for _, rows in curves[curves["n_pairs"] > 0].groupby(keys, sort=False):
                first = rows.to_dict("records")[0]
                n_pairs, of, each = first["n_pairs"], len(rows), " a scene"
                n_better, n_equal = rows["is_better"].sum(), (rows["change"] == 0).sum()
                if self.unit == "scene":
                    rows = rows.iloc[:1]  # all scenes
                    n_better, n_equal, of, each = first["n_better"], first["n_equal"], n_pairs, ""
                base, new = rows["base_mean"].mean(), rows["new_mean"].mean()
                relative = f", {100 * (new - base) / abs(base):+.0f} %" if base else ""
                few = ""
                if not np.isfinite(rows["smallest_effect"]).any():
                    needed = f"{first['trials_needed']:g} needed"
                    few = f"; {plural(n_pairs, self.unit)}{each}, too few for a test ({needed})"
                equal = f", equal on {n_equal}" if n_equal else ""
                where = f"better on {n_better} of {plural(of, 'scene')}{equal}{few}"
                name = self.name(first, before=" of ")
                lines.append(f"{tolerance.metric}{name}: {new:.3g} against {base:.3g}{relative}, {where}")
        return lines

    def lines(self) -> list[str]:
        """Write what tables do not show: cells that one side alone has, and what was not compared."""
        lines = [SCENE_LINE] if self.comparison.unit == "scene" else []
        lines += [self.cell_line(cells, what) for cells, what in self.lost + self.gained if len(cells)]
        if n_failed_both := len(self.comparison.changed_cells("failed_both")):
            lines.append(f"{plural(n_failed_both, 'cell')} failed in both, left out")
        return [*lines, *self.comparison.notes]

    def cell_line(self, cells: pd.DataFrame, what: str) -> str:
        """Count the cells that something became of, in words, and name the first few."""
        named = []
        for cell in cells.head(CELLS_NAMED).to_dict("records"):
            reason = f" ({': '.join(filter(None, [cell['status'], cell['reason']]))})"
            named.append(
                f"{self.name(cell, after=' on ')}{cell['scenario']} at {cell['snr_db']:g} dB, "
                f"trial {cell['trial']}{'' if cell['status'] == 'ok' else reason}"
            )
        more = "; ..." if len(cells) > CELLS_NAMED else ""
        return f"{plural(len(cells), 'cell')} {what}: {'; '.join(named)}{more}"

    def summary(self) -> str:
        """Write the outcome in one line, with the counts of verdicts."""
        return f"{self.outcome}: {self.counts()}"

    def counts(self) -> str:
        """Count verdicts of curves and points, and lost cells and scores."""
        points = self.comparison.points[self.comparison.points["n_snr"] > 1]
        parts = [
            f"of {plural(len(table), noun)} {verdict_counts(table, self.verdict)}"
            for table, noun in ((self.comparison.curves, "curve"), (points, "point"))
            if len(table)
        ]
        parts += [f"{plural(len(cells), 'cell')} {what}" for cells, what in self.lost if len(cells)]
        return "; ".join([*parts, *filter(None, [self.lost_scores])]) or "nothing compared"

    def content(self) -> dict[str, Any]:
        """Describe a comparison in terms of JSON; numbers that are not finite are null."""
        one = self.comparison
        content: dict[str, Any] = {
            "comparable": True,
            "regression": one.is_regression,
            "base": {"folder": one.base, "version": one.base_version},
            "new": {"folder": one.new, "version": one.new_version},
            "between": self._between,
            "alpha": one.alpha,
            "tolerances": [dataclasses.asdict(tolerance) for tolerance in one.tolerances],
            "curves": json_rows(one.curves),
            "points": json_rows(one.points),
            "cells": {
                "n_paired": one.n_paired,
                "n_failed_both": len(one.changed_cells("failed_both")),
                **{name: json_rows(one.changed_cells(change)) for name, change in CELL_TABLES.items()},
                "n_lost_scores": one.n_lost_scores,
            },
            "notes": list(one.notes),
        }
        if self.unit == "scene":
            content |= {"unit": self.unit, "scenes": json_rows(self.comparison.scenes)}
        return content

    def paths(self, folder: Path, plot: Path | None = None) -> dict[str, Path]:
        """Name the files for the figures of a comparison, by score.

        By default ``figures/compare-<score>.png`` in the folder of the new run, of two estimators
        ``figures/between-<score>.png``. Instead `plot`, to whose stem all scores but the first add theirs.
        """
        curves = self.comparison.curves
        metrics = curves.loc[curves["n_pairs"] > 0, "metric"].unique().tolist()
        stems = file_stems(metrics)
        if plot is None:
            stem = "compare" if self.comparison.between is None else "between"
            return {metric: folder / FOLDER / f"{stem}-{stems[metric]}.png" for metric in metrics}
        require_picture(plot)
        others = {metric: plot.with_stem(f"{plot.stem}-{stems[metric]}") for metric in metrics[1:]}
        return {**dict.fromkeys(metrics[:1], plot), **others}

    def draw(self, folder: Path, plot: Path | None = None) -> list[Path]:
        """Draw every score of a comparison into the files that `paths` names."""
        if plot is None:
            make_own_folder(folder / FOLDER)
        with styled():
            paths = self.paths(folder, plot)
            return [save(draw_charts(self.charts(metric)), path) for metric, path in paths.items()]

    def charts(self, metric: str) -> ChartGroup:
        """One score of both sides over the SNR, a chart a curve, points that changed marked.

        Of more than twelve curves those with the worst verdicts.
        """
        points, curves = (
            table[(table["metric"] == metric) & (table["n_pairs"] > 0)]
            for table in (self.comparison.points, self.comparison.curves)
        )
        shown = curves
        if len(curves) > MOST_CHARTS:  # a curve may hide that one of its points is worse
            shown = _worst_first(pd.concat([curves, points]))[CURVE].drop_duplicates()[:MOST_CHARTS]
            shown = shown.merge(curves, on=CURVE)
        part = f", {len(shown)} of {len(curves)} curves" if len(shown) < len(curves) else ""
        n_pairs = int(curves["n_pairs"].max())
        of_scenes = f"mean of {n_pairs} scenes, 95 % confidence band"
        mean = f"mean of {trials_and_band(n_pairs)}" if self.unit == "trial" else of_scenes
        of_curve, panels = points.groupby(CURVE), []
        for curve in shown.to_dict("records"):
            own = of_curve.get_group(tuple(curve[key] for key in CURVE)).sort_values("snr_db")
            y = Axis(score_of(metric).name, limits=_limits(own))
            panels.append(Chart(self._title(curve), Axis("SNR [dB]"), y, self._series(own)))
        return ChartGroup("compare", f"{metric} of paired cells: {mean}{part}", panels, n_columns=3)

    def _series(self, points: pd.DataFrame) -> list[Series]:
        """Both curves with their bands, and rings around points that changed."""
        series = []
        for style, side, label in zip((BASE, NEW), ("base", "new"), self.legend, strict=True):
            mean, band = points[f"{side}_mean"], points[f"{side}_band"]
            series.append(Series(label, points["snr_db"], mean, mean - band, mean + band, style=style))
        for verdict, style in RINGS.items():
            marked = points[points["verdict"] == verdict]
            if len(marked):
                label = self.verdict(verdict)
                series.append(Series(label, marked["snr_db"], marked["new_mean"], mark="points", style=style))
        return series

    def _title(self, curve: Row) -> str:
        """Name a curve, and what became of it as a whole."""
        relative = curve["relative"]
        change = f" ({100 * relative:+.3g} %)" if relative and np.isfinite(relative) else ""
        place = shortened(self._place(curve), LONGEST_TITLE)
        return f"{place}\nwhole curve: {self.verdict(curve['verdict'])}{change}"


def _fine(comparison: Comparison, first: str, second: str) -> str:
    """Outcome of two estimators of which the second one is not worse by any test."""
    curves = comparison.curves[comparison.curves["n_pairs"] > 0]
    if (curves["verdict"] == "improvement").any():
        return f"{second} is better than {first}"
    if len(curves) and curves["is_better"].all():
        return f"{second} is better than {first} everywhere, which is not tested or may be chance"
    return f"no test shows {second} to be worse than {first}"


def _worst_first(table: pd.DataFrame) -> pd.DataFrame:
    """Sort curves or points by their verdicts."""
    return table.sort_values("verdict", key=lambda verdicts: verdicts.map(VERDICTS.index), kind="stable")


def _limits(points: pd.DataFrame) -> tuple[float, float]:
    """Bands do not dwarf the means, and curves that hardly vary are not blown up to fill the chart."""
    means = points[["base_mean", "new_mean"]].to_numpy()
    low, high = float(means.min()), float(means.max())
    margin = max(0.3 * (high - low), 0.1 * max(abs(low), abs(high))) or 1.0
    return low - margin, high + margin


def comparison_markdown(comparison: Comparison) -> str:
    """Write a comparison as Markdown of bounded length.

    The verdict comes first, then the counts, what was compared, a table of curves and one of changed points
    for each score, cells and notes, as far as they fit.
    """
    report = ComparisonReport(comparison)
    lines = [_line(report.counts()), "", *_items([*report.heading, *report.effect_lines()]), ""]
    for table in report.tables():
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
    lines = [f"### isacbench compare: {_line(outcome)}", "", *lines]
    ends = np.cumsum([len(line) + 1 for line in lines])
    fitting = lines[: int((ends <= MAX_CHARACTERS).sum())]
    if len(fitting) < len(lines):
        fitting += ["", "The rest is left out: it is too long. `isacbench compare --json` has all of it."]
    return "\n".join(fitting) + "\n"


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
        for scenario, part in curves.groupby("scenario", sort=False):
            suite = ET.SubElement(root, "testsuite", name=escape_control(f"{tolerance}: {scenario}"))
            points = changed[changed["scenario"] == scenario]
            for row in [*part.to_dict("records"), *points.to_dict("records")]:
                place = f"at {row['snr_db']:g} dB" if "snr_db" in row else "whole curve"
                name = f"{report.name(row, after=', ')}{place}"
                problem = "failure" if row["verdict"] == "regression" else ""
                _add_case(suite, name, _outcome(row, tolerance, report), problem, worse)
    suite = ET.SubElement(root, "testsuite", name="cells")
    lost = {
        f"cells {what}": report.cell_line(cells, what) if len(cells) else "" for cells, what in report.lost
    }
    lost[f"scores missing in {report.sides[1]}"] = report.lost_scores
    for name, text in lost.items():
        _add_case(suite, f"no {name}", text, "failure" if text else "", worse)
    return _xml(root, [*report.heading, *report.lines(), *report.scene_lines()])


def incomparable_junit(base: str, new: str, reasons: Sequence[str]) -> str:
    """Write that two runs, given by their folders, cannot be compared: an error for each reason."""
    root = ET.Element("testsuites", name="isacbench compare")
    suite = ET.SubElement(root, "testsuite", name="comparable")
    for reason in reasons:
        _add_case(suite, reason, reason, "error", "not comparable")
    return _xml(root, [f"base {base}", f"new {new}"])


def _outcome(row: Row, tolerance: Tolerance, report: ComparisonReport) -> str:
    """Verdict and numbers of a curve or point in a sentence."""
    texts = {column.heading: column.text(row) for column in report.number_columns(tolerance)}
    verdict = texts.pop("verdict")
    parts = [f"{heading} {text}" for heading, text in texts.items() if text]
    return f"{verdict}; {', '.join([*parts, plural(row['n_pairs'], report.unit)])}"


def _add_case(suite: ET.Element, name: str, text: str, problem: str, kind: str) -> None:
    """Add a test case to a suite.

    Its text is its output, or the message of a problem, a failure or an error, of a kind.
    """
    text = escape_control(text)
    case = ET.SubElement(suite, "testcase", classname=suite.get("name", ""), name=escape_control(name))
    if problem:
        ET.SubElement(case, problem, type=kind, message=text).text = text
    elif text:
        ET.SubElement(case, "system-out").text = text


def _xml(root: ET.Element, lines: Sequence[str]) -> str:
    """Write suites of cases with their numbers, and lines as the output of the last suite."""
    for element in (*root, root):
        for name, tag in (("tests", "testcase"), ("failures", "failure"), ("errors", "error")):
            element.set(name, str(len(element.findall(f".//{tag}"))))
    ET.SubElement(root[-1], "system-out").text = "\n".join(map(escape_control, lines))
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'
