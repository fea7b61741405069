"""The kind ``efficiency``: one scatterer anywhere, and how far errors lie above the Cramér-Rao bound.

Each trial puts one unit scatterer at a place that knows no grid; the same place
for every SNR and estimator. A point within one Rayleigh cell of it in range,
velocity, u and w is a hit, all others are false. Errors count where there is
a hit: an estimator that reports only what it is sure of can look better than
the bound, which is why misses are counted beside them.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from functools import partial
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from isacbench import charts
from isacbench.bench import statistics
from isacbench.bench.cells.images import Image
from isacbench.bench.cells.rows import failed
from isacbench.bench.cells.task import ImagingTask, build_estimators
from isacbench.bench.kinds import kind
from isacbench.bench.kinds.kind import NO_SCENARIOS, SNR_GAIN, Kind, Scenarios
from isacbench.bench.suites.suite import Suite
from isacbench.charts import VARIANT, Axis, Chart, ChartGroup, Column, LineStyle, Series, Table
from isacbench.dsp.bounds import single_bound
from isacbench.model.radio_coordinates import draw_place, radio_places, rayleigh_cells, space_places
from isacbench.model.scene import Scatterers, Scenario

MARGIN_CELLS = 0.5
"""Rayleigh cells between a scatterer and the region's border: beyond it errors would be cut off."""

UNITS = {"range": ("range_m", " [m]"), "velocity": ("velocity_mps", " [m/s]"), "u": ("u", ""), "w": ("w", "")}
"""Ends of the names of columns, and units of axes, by dimension."""

TITLES = {"range": "Range", "velocity": "Velocity", "u": "Direction cosine u", "w": "Direction cosine w"}
"""Titles of charts by dimension."""

ERRORS, BOUNDS = ([f"{what}_{column}" for column, _ in UNITS.values()] for what in ("error", "bound"))
"""Errors of a hit, which have a sign, and Cramér-Rao bounds, standard deviations."""

BOUND_STYLE = LineStyle("", "dash", "")
SNR_AXIS, SHARE_AXIS = Axis("SNR after gain [dB]"), Axis("share of trials", limits=charts.SHARE_LIMITS)
RATIO_AXIS = Axis("error over bound", log=True, limits=(0.7, 10.0))
"""Ten times the bound are far from it, however far."""


class EfficiencyKind(Kind):
    """Errors of one scatterer, compared with the Cramér-Rao bound."""

    name = "efficiency"
    columns: ClassVar = {
        **SNR_GAIN,
        "hit": False,
        "n_false": 0,
        **dict.fromkeys([*ERRORS, *BOUNDS], math.nan),
    }
    better: ClassVar = {"hit": "higher", **dict.fromkeys([*SNR_GAIN, *ERRORS, *BOUNDS], "neither")}

    def tasks(self, suite: Suite, scenarios: Scenarios) -> list[ImagingTask]:
        """Plan one task a scenario: one scatterer in its region."""
        entries, tasks = build_estimators(suite), []
        for scenario in scenarios.values():
            scenario.require_default("the Cramér-Rao bound", "noise")
            draw = partial(_draw, scenario, suite.seed)
            tasks.append(ImagingTask(suite, scenario, entries, draw=draw, measure=measure_efficiency))
        return tasks

    def summary(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Root mean square errors over the bound, of every estimator at every SNR.

        One row for each scenario, estimator and SNR: ``snr_gain_db``; the counts ``n_trials``, ``n_failed``,
        ``n_misses`` (without failures) and ``n_false``; for each of range, velocity, u and w ``rmse_<x>`` and
        ``bound_<x>`` in its unit and ``ratio_<x>`` of the two with its 95 % interval ``ratio_<x>_low``,
        ``ratio_<x>_high``, all of the trials with a hit, the interval of five or more;
        ``time_estimate_s_median``.
        """
        return statistics.summarise(rows, ["scenario", *VARIANT, "snr_db"], _numbers)

    def tables(self, rows: pd.DataFrame) -> list[Table]:
        """Errors over the bound, one table a scenario and estimator."""
        tables, words = kind.number_tables(rows), statistics.time_words(rows)
        columns = [
            Column("SNR: after gain [dB]", "snr_gain_db", "{:.4g}", part=0),
            Column("missed", form=_missed_text),
            Column("false: points", "n_false"),
            *(Column(name, form=partial(_ratio_text, f"ratio_{name}")) for name in UNITS),
            Column("time [ms]", "time_estimate_s_median", "{:.1f}", scale=1e3),
        ]
        summary = kind.with_labels(self.summary(rows)).sort_values("snr_gain_db", kind="stable")
        for (scenario, label), part in summary.groupby(["scenario", "label"], sort=False):
            trials = statistics.trials_and_band(part["n_trials"].max())
            title = f"{scenario}, {label}: error over Cramér-Rao bound, {trials}; {words}"
            tables.append(Table(title, columns, part))
        return tables

    def charts(self, rows: pd.DataFrame, scenarios: Scenarios = NO_SCENARIOS) -> list[ChartGroup]:
        """Errors beside their bound, errors over it, misses and false points, over SNR."""
        summary, lines, groups = _with_shares(self.summary(rows)), kind.lines_of(rows), []
        for scenario, stem, part in kind.title_stems(summary, "scenario"):
            over_snr = partial(charts.line_series, part, lines, "snr_gain_db")
            bounds = part.drop_duplicates("snr_gain_db").sort_values("snr_gain_db")
            errors, ratios = [], []
            for name, (column, unit) in UNITS.items():
                title, of_bound = TITLES[name], (bounds["snr_gain_db"], bounds[f"bound_{column}"])
                series = over_snr(f"rmse_{column}", f"rmse_{column}")
                series.append(Series("Cramér-Rao bound", *of_bound, style=BOUND_STYLE))
                axis = Axis(f"root mean square error{unit}", log=True)
                errors.append(Chart(title, SNR_AXIS, axis, series))
                series = over_snr(f"ratio_{name}", f"ratio_{name}")
                ratios.append(Chart(f"{title}: error over the bound", SNR_AXIS, RATIO_AXIS, series, [1.0]))
            missed = Chart("Missed", SNR_AXIS, SHARE_AXIS, over_snr("missed"))
            false = Chart("False points", SNR_AXIS, Axis("number a trial"), over_snr("false"))
            trials = statistics.trials_and_band(part["n_trials"].max())
            title = f"{scenario}: one scatterer, errors where it was found; {trials}"
            panels = [*errors, missed, *ratios, false]
            groups.append(ChartGroup(f"efficiency-{stem}", title, panels, n_columns=5))
        return groups


def measure_efficiency(image: Image) -> dict[str, Any]:
    """Measure an image of one scatterer: hit or miss, false points, errors of the hit, and their bounds.

    A hit is a point within one Rayleigh cell of the scatterer in range, velocity, u and w. The nearest one
    has the errors, the distance counted in cells; all other points are false.
    """
    scenario = image.scenario
    cells = rayleigh_cells(scenario)
    error = radio_places(scenario, image.cloud) - radio_places(scenario, scenario.scatterers)
    hits = np.flatnonzero((np.abs(error) < cells).all(axis=1))
    element_snr = 10 ** (image.snr_db / 10) / scenario.array.n_turns
    bound = single_bound(scenario.system, scenario.array.shape, element_snr)
    measured: dict[str, Any] = {"hit": hits.size > 0, "n_false": len(error) - (hits.size > 0)}
    measured |= dict(zip(BOUNDS, np.sqrt(np.diag(bound.covariance)).tolist(), strict=True))
    if hits.size:
        nearest = hits[np.argmin(np.sum((error[hits] / cells) ** 2, axis=1))]
        measured |= dict(zip(ERRORS, error[nearest].tolist(), strict=True))
    return measured


def _with_shares(summary: pd.DataFrame) -> pd.DataFrame:
    """Add shares, and give errors the relative band of their ratio; leave out those of one hit of many."""
    n_trials = summary["n_trials"]
    is_measured = (n_trials - summary["n_failed"] - summary["n_misses"] > 1) | (n_trials == 1)
    columns = {"missed": summary["n_misses"] / n_trials, "false": summary["n_false"] / n_trials}
    for name, (column, _) in UNITS.items():
        for end in ("", "_low", "_high"):
            ratio = summary[f"ratio_{name}{end}"].where(is_measured)
            columns[f"ratio_{name}{end}"] = ratio
            columns[f"rmse_{column}{end}"] = ratio / summary[f"ratio_{name}"] * summary[f"rmse_{column}"]
    return summary.assign(**columns)


def _missed_text(row: Mapping[Any, Any]) -> str:
    return charts.with_failures(f"{row['n_misses'] / row['n_trials']:.3f}", row["n_failed"])


def _ratio_text(column: str, row: Mapping[Any, Any]) -> str:
    """Error over bound with its interval; empty without a hit."""
    ends = (charts.number_or_blank(row[f"{column}{end}"], "{:.2f}") for end in ("", "_low", "_high"))
    ratio, low, high = ends
    return f"{ratio} ({low}-{high})" if low else ratio


def _numbers(part: pd.DataFrame) -> dict[str, Any]:
    """Counts of one group, and errors and bounds of its trials with a hit."""
    broken, hits = failed(part), part[part["hit"]]
    numbers: dict[str, Any] = {
        "snr_gain_db": part["snr_gain_db"].iloc[0],
        "n_trials": len(part),
        "n_failed": int(broken.sum()),
        "n_misses": int((~broken & ~part["hit"]).sum()),
        "n_false": int(part["n_false"].sum()),
    }
    for dimension, (column, _) in UNITS.items():
        error, bound = hits[f"error_{column}"], hits[f"bound_{column}"]
        numbers[f"rmse_{column}"] = math.sqrt((error**2).mean())
        numbers[f"bound_{column}"] = part[f"bound_{column}"].mean()
        names = (f"ratio_{dimension}{end}" for end in ("", "_low", "_high"))
        numbers |= zip(names, statistics.rms_interval((error / bound).to_numpy()), strict=True)
    return numbers


def _draw(scenario: Scenario, seed: int, trial: int) -> Scenario:
    """Scenario of a trial: the template's radio and region, one unit scatterer."""
    xyz, velocity = space_places(scenario, draw_place(scenario, trial, seed, MARGIN_CELLS)[None])
    return dataclasses.replace(scenario, scatterers=Scatterers(xyz, velocity, np.ones(1)))
