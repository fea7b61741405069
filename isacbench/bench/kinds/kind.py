"""The kind of a suite: what is planned, measured, summarised, tabulated and drawn of it."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, ClassVar

import pandas as pd

from isacbench import charts
from isacbench.bench.cells.rows import COLUMNS, REFERENCE_COLUMNS, TIMING_COLUMNS
from isacbench.bench.cells.task import Task
from isacbench.bench.labels import estimator_labels, references_in
from isacbench.bench.suites.suite import Suite
from isacbench.charts import ChartGroup, Line, Table, Variant, variants_in
from isacbench.errors import InputError
from isacbench.files.escaping import file_stems
from isacbench.metrics.descriptions import Direction
from isacbench.model.scene import Scenario
from isacbench.plugins.contracts import Metric
from isacbench.plugins.scoring import Metrics

SNR_GAIN: Mapping[str, float] = {"snr_gain_db": math.nan}
"""Column of every kind of suite that knows the SNR after all gain (array and processing)."""

OF_IMAGES = "points", "occupancy", "objects"
"""Metrics beside ``paper`` of suites whose images are scored."""

Scenarios = Mapping[str, "Scenario"]
NO_SCENARIOS: Scenarios = {}


class Kind(ABC):
    """Kind of suite. It gives data, and knows nothing of how they are laid out.

    Attributes
    ----------
    name : str
        Value of the key ``kind``.
    suite : type of Suite
        Class with the keys of its suites.
    columns : mapping of str to Any
        Columns that the kind adds to the rows, each with its value in the row of a failed cell, whose type
        (str, bool, int, float) is that of the column. Rows from before the column was added have it as
        well: take NaN where 0 would be false. The summaries of images average those of numbers,
        without failed cells. Where `measure` of an `ImagingTask` gives them, it sees one realisation of a
        reference, whose scores are means over all of them.
    better : mapping of str to {"lower", "higher", "neither"}
        Better direction of a column; columns that are not listed are better ``"lower"``.
    metrics : tuple of str
        Metrics beside ``paper`` that score the images of a suite that names none.
    has_scenes : bool
        Whether its scenarios are scenes as they are, over which estimators are ranked and compared.
    has_images : bool
        Whether images of these scenes are drawn, too.
    """

    name: ClassVar[str]
    suite: ClassVar[type[Suite]] = Suite
    columns: ClassVar[Mapping[str, Any]] = {}
    better: ClassVar[Mapping[str, Direction]] = {}
    metrics: ClassVar[tuple[str, ...]] = ()
    has_scenes: ClassVar[bool] = False
    has_images: ClassVar[bool] = False

    @abstractmethod
    def tasks(self, suite: Any, scenarios: Scenarios) -> Sequence[Task]:
        """Plan the tasks of a suite on scenarios by name; an `InputError` where it cannot be run on them."""

    @abstractmethod
    def summary(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Summarise the rows of a run: ``summary.csv``."""

    @abstractmethod
    def tables(self, rows: pd.DataFrame) -> list[Table]:
        """Tabulate the rows of a run: what is printed, and ``summary.md``."""

    @abstractmethod
    def charts(self, rows: pd.DataFrame, scenarios: Scenarios = NO_SCENARIOS) -> list[ChartGroup]:
        """Draw the rows of a run, with what its scenarios tell as far as they are known."""

    def metric_specs(self, suite: Suite) -> tuple[str, ...]:
        """Metrics beside ``paper`` that score the images of a suite: those that it names, or the kind's."""
        return self.metrics if suite.metrics is None else suite.metrics

    def metrics_of(self, suite: Suite) -> Metrics:
        """Build the metrics that images of a suite are scored by.

        An `InputError` where one is unknown, is listed twice, or has a column that rows have without it.
        """
        metrics = Metrics.of(self.metric_specs(suite))
        for metric in metrics.further:
            if taken := taken_columns(metric, self.columns):
                raise InputError(
                    f"metric {metric.name}: rows have a column {taken[0]} already; allowed are other names"
                )
        return metrics


def taken_columns(metric: Metric, of_kinds: Iterable[str]) -> list[str]:
    """List the columns of a metric that would replace others of rows: keys, times, or those of kinds."""
    others = {*COLUMNS, "label", "ratio", *TIMING_COLUMNS, *REFERENCE_COLUMNS} - Metrics().columns(()).keys()
    return [column.name for column in metric.columns if column.name in others | {*of_kinds}]


def lines_of(rows: pd.DataFrame) -> dict[Variant, Line]:
    """Label and style of every estimator of a run, the same in all its charts."""
    return charts.assign_lines(estimator_labels(variants_in(rows)), references_in(rows))


def labels_of(rows: pd.DataFrame) -> dict[Variant, str]:
    """Short label of every estimator of a run, the same in all its tables."""
    return charts.short_labels(estimator_labels(variants_in(rows)))


def with_labels(rows: pd.DataFrame) -> pd.DataFrame:
    """Add the short label of each estimator, the same in all tables of a run, as the column ``label``."""
    labels = labels_of(rows)
    return rows.assign(label=[labels[one] for one in zip(rows["estimator"], rows["params"], strict=True)])


def number_tables(rows: pd.DataFrame) -> list[Table]:
    """Table of what the numbers in short labels stand for, if there are any."""
    return charts.number_table(estimator_labels(variants_in(rows)))


def title_stems(table: pd.DataFrame, column: str) -> Iterator[tuple[str, str, pd.DataFrame]]:
    """Go through the parts of a table by the names in a column: name, stem of a file name, and rows."""
    stems = file_stems(table[column].unique())
    for name, part in table.groupby(column, sort=False):
        yield str(name), stems[str(name)], part
