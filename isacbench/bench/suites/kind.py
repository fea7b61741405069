"""The kind of a suite: one object that names the code to plan, tabulate, draw and compare its runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, NamedTuple

from isacbench.bench.suites.suite import Suite

if TYPE_CHECKING:
    from isacbench.bench.studies.study import Scene
    from isacbench.metrics.descriptions import Direction
    from isacbench.model.scene import Scenario


class Tables(NamedTuple):
    """Functions that tabulate the records of a run, each as ``module:function``.

    Attributes
    ----------
    summary : str
        From records to a DataFrame, which becomes ``<stem>.csv``.
    grids : str
        From records to a list of `isacbench.report.tables.run_tables.Grid`, which are printed and become
        ``<stem>.md``. Empty: nothing is printed.
    """

    summary: str
    grids: str = ""


STAGES = Tables(
    "isacbench.report.tables.stage_tables:summarise_stages",
    "isacbench.report.tables.stage_tables:stage_grids",
)
"""Times of stages, which every kind of suite has."""


OF_TIMED_IMAGES = {
    "stages": STAGES,
    "pareto": Tables("isacbench.report.tables.pareto:summarise_times"),
}
"""Tables of timed runs whose images are scored."""


OF_IMAGES = "points", "occupancy", "objects"
"""Metrics beside ``paper`` of suites whose images are scored."""


@dataclass(frozen=True)
class Kind:
    """Kind of suite.

    Code is named as ``module:function`` and imported when it is called. A suite is
    therefore checked before NumPy is imported, and `bench` imports nothing from `report`.

    Attributes
    ----------
    name : str
        Value of the key ``kind``.
    plan : str
        Function from a suite and its scenarios by name to a sequence of
        `isacbench.bench.studies.study.Scene`.
    tables : Tables
        Summary of the records, ``summary.csv`` and ``summary.md``.
    figures : str
        Function from `isacbench.bench.store.run.Run` to pairs of the stem of a file and a figure.
    suite : type of Suite
        Class with the keys of its suites.
    columns : mapping of str to Any
        Columns that the kind adds to the rows, each with its value in the row of a failed cell.
    better : mapping of str to {"lower", "higher", "neither"}
        Better direction of a column; columns that are not listed are better ``"lower"``.
    metrics : tuple of str
        Metrics beside ``paper`` that score the images of a suite that names none.
    timed_tables : mapping of str to Tables
        Further tables of a timed run, by the stem of their files.
    """

    name: str
    plan: str
    tables: Tables
    figures: str
    suite: type[Suite] = Suite
    columns: Mapping[str, Any] = field(default_factory=dict)
    better: Mapping[str, Direction] = field(default_factory=dict)
    metrics: tuple[str, ...] = ()
    timed_tables: Mapping[str, Tables] = field(default_factory=lambda: {"stages": STAGES})

    def scenes(self, suite: Suite, scenarios: Mapping[str, Scenario]) -> Sequence[Scene]:
        """Plan the scenes of a suite.

        Parameters
        ----------
        suite : Suite
            Of this kind.
        scenarios : mapping of str to Scenario
            By name.

        Returns
        -------
        sequence of Scene

        Raises
        ------
        InputError
            If the suite cannot be run on the scenarios.
        """
        scenes: Sequence[Scene] = resolve_name(self.plan)(suite, scenarios)
        return scenes


SNR_GAIN: Mapping[str, float] = {"snr_gain_db": math.nan}
"""Column of every kind of suite that knows the SNR after all gain (array and processing)."""
