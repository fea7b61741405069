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
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from isacbench.bench.cells.record import failed
from isacbench.bench.kinds.kind import (
    NO_SCENARIOS,
    SNR_GAIN,
    Kind,
    labels_of,
    lines_of,
    number_tables,
    title_stems,
)
from isacbench.bench.kinds.scenes import ImagedScene, build_estimators, element_snrs_db
from isacbench.bench.statistics import (
    TIME,
    median_times,
    rms_interval,
    summarise,
    time_words,
    trials_and_band,
)
from isacbench.charts import (
    SHARE_LIMITS,
    Axis,
    Chart,
    ChartGroup,
    Column,
    LineStyle,
    Series,
    Table,
    line_series,
    number_or_blank,
    with_failures,
)
from isacbench.dsp.bounds import single_bound
from isacbench.model.radio_coordinates import (
    DIMENSIONS,
    draw_place,
    gain_db,
    radio_places,
    rayleigh_cells,
    space_places,
)
from isacbench.model.scene import Scatterers

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd

    from isacbench.bench.cells.cell import MeasuredImage
    from isacbench.bench.suites.suite import Suite
    from isacbench.metrics.descriptions import Direction
    from isacbench.model.scene import Scenario

MARGIN_CELLS = 0.5
"""Rayleigh cells between a scatterer and the region's border: beyond it errors would be cut off."""

UNITS = {"range": ("range_m", " [m]"), "velocity": ("velocity_mps", " [m/s]"), "u": ("u", ""), "w": ("w", "")}
"""Ends of the names of columns, and units of axes, by dimension."""

DIMENSION_TITLES = {
    "range": "Range",
    "velocity": "Velocity",
    "u": "Direction cosine u",
    "w": "Direction cosine w",
}

ERRORS = [f"error_{column}" for column, _ in UNITS.values()]
"""Errors of a hit, which have a sign."""

BOUNDS = [f"bound_{column}" for column, _ in UNITS.values()]
"""Cramér-Rao bounds, standard deviations."""

CURVE = ["scenario", "estimator", "params"]

RATIO_LIMITS = 0.7, 10.0
"""Ends of an axis of errors over their bound: ten times are far from it, however far."""

FEWEST_FALSE = 0.1
"""Fewer false points a trial do not stretch their axis."""


class EfficiencyKind(Kind):
    """Errors of one scatterer, compared with the Cramér-Rao bound."""

    name = "efficiency"
    columns: ClassVar[Mapping[str, Any]] = {
        **SNR_GAIN,
        "hit": False,
        "n_false": 0,
        **dict.fromkeys([*ERRORS, *BOUNDS], math.nan),
    }
    better: ClassVar[Mapping[str, Direction]] = {
        "hit": "higher",
        **dict.fromkeys([*SNR_GAIN, *ERRORS, *BOUNDS], "neither"),
    }

    def scenes(self, suite: Suite, scenarios: Mapping[str, Scenario]) -> list[ImagedScene]:
        """Plan one scene a scenario: one scatterer in its region."""
        entries = build_estimators(suite)
        found = []
        for scenario in scenarios.values():
            scenario.require_default("the Cramér-Rao bound", "noise")
            draw = partial(_draw, scenario, suite.seed)
            snr_db = element_snrs_db(suite, gain_db(draw(0)))
            found.append(ImagedScene(suite, scenario, entries, snr_db, draw=draw, measure=measure_efficiency))
        return found

    def summary(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Root mean square errors over the bound, of every estimator at every SNR.

        Returns
        -------
        DataFrame
            One row for each scenario, estimator (with its parameters) and SNR: ``snr_gain_db``; the counts
            ``n_trials``, ``n_failed``, ``n_misses`` (without failures) and ``n_false``; for each of range,
            velocity, u and w ``rmse_<x>`` and ``bound_<x>`` in its unit and ``ratio_<x>`` of the two with its
            95 % interval ``ratio_<x>_low``, ``ratio_<x>_high``, all of the trials with a hit, the interval of
            five or more; ``time_estimate_s_median``.
        """
        return summarise(rows, [*CURVE, "snr_db"], _numbers)

    def tables(self, rows: pd.DataFrame) -> list[Table]:
        """Errors over the bound, one table a scenario and estimator."""
        summary, labels = self.summary(rows), labels_of(rows)
        times_s = median_times(rows, CURVE)[f"{TIME}_median"]
        columns = [
            Column("SNR: after gain [dB]", "snr_gain_db", "{:.4g}", part=0),
            Column("missed", form=_missed),
            Column("false: points", "n_false"),
            *(Column(name, form=partial(_ratio_text, f"ratio_{name}")) for name in DIMENSIONS),
        ]
        found = number_tables(rows)
        for key, part in summary.groupby(CURVE, sort=False):
            scenario, name, params = map(str, key)
            band = trials_and_band(int(part["n_trials"].max()), "interval")
            title = f"{scenario}, {labels[name, params]}: error over Cramér-Rao bound, {band}"
            time_ms = 1e3 * times_s.get(key, math.nan)
            title += number_or_blank(time_ms, f"; {time_words(rows)} {{:.1f}} ms")
            found.append(Table(title, columns, part.sort_values("snr_gain_db")))
        return found

    def charts(
        self, rows: pd.DataFrame, scenarios: Mapping[str, Scenario] = NO_SCENARIOS
    ) -> list[ChartGroup]:
        """Errors beside their bound, errors over it, misses and false points, over SNR."""
        summary, lines = (
            self.summary(rows).assign(missed=_share("n_misses"), false=_share("n_false")),
            lines_of(rows),
        )
        snr = Axis("SNR after gain [dB]")
        found = []
        for scenario, stem, part in title_stems(summary, "scenario"):
            part = _measured(part)
            errors, ratios = [], []
            for name in DIMENSIONS:
                column, unit = UNITS[name]
                bounds = part.drop_duplicates("snr_gain_db").sort_values("snr_gain_db")
                bound = Series(
                    "Cramér-Rao bound", bounds["snr_gain_db"], bounds[f"bound_{column}"], style=BOUND_STYLE
                )
                drawn = line_series(part, lines, "snr_gain_db", f"rmse_{column}", f"rmse_{column}")
                title, axis = DIMENSION_TITLES[name], Axis(f"root mean square error{unit}", log=True)
                errors.append(Chart(title, snr, axis, [*drawn, bound]))
                drawn = line_series(part, lines, "snr_gain_db", f"ratio_{name}", f"ratio_{name}")
                axis = Axis("error over bound", log=True, limits=RATIO_LIMITS)
                ratios.append(Chart(f"{title}: error over the bound", snr, axis, drawn, lines=[1.0]))
            top = max(1.06 * float(part["false"].max()), FEWEST_FALSE)
            missed, false = (line_series(part, lines, "snr_gain_db", name) for name in ("missed", "false"))
            errors.append(Chart("Missed", snr, Axis("share of trials", limits=SHARE_LIMITS), missed))
            ratios.append(
                Chart("False points", snr, Axis("number a trial", limits=(-0.03 * top, top)), false)
            )
            title = (
                f"{scenario}: one scatterer, errors where it was found; "
                f"{trials_and_band(int(part['n_trials'].max()))}"
            )
            found.append(ChartGroup(f"efficiency-{stem}", title, [*errors, *ratios], n_columns=5))
        return found


BOUND_STYLE = LineStyle("", "dash", "")


def measure_efficiency(shot: MeasuredImage) -> dict[str, Any]:
    """Measure an image of one scatterer.

    Returns
    -------
    dict
        ``hit``, whether a point lies within one Rayleigh cell of the
        scatterer in range, velocity, u and w; ``n_false``, all points but
        one of those; the errors of the nearest, counted in cells; and the
        Cramér-Rao bounds, standard deviations in the same units.
    """
    scenario = shot.scenario
    cells = rayleigh_cells(scenario)
    error = radio_places(scenario, shot.cloud) - radio_places(scenario, scenario.scatterers)
    inside = np.flatnonzero((np.abs(error) < cells).all(axis=1))
    measured: dict[str, Any] = {"hit": inside.size > 0, "n_false": len(error) - (inside.size > 0)}
    bound = single_bound(
        scenario.system, scenario.array.shape, 10 ** (shot.snr_db / 10) / scenario.array.n_turns
    )
    measured |= dict(zip(BOUNDS, np.sqrt(np.diag(bound.covariance)).tolist(), strict=True))
    if inside.size:
        nearest = inside[np.argmin(np.sum((error[inside] / cells) ** 2, axis=1))]
        measured |= dict(zip(ERRORS, error[nearest].tolist(), strict=True))
    return measured


def _share(column: str) -> Any:
    return lambda table: table[column] / table["n_trials"]


def _measured(part: pd.DataFrame) -> pd.DataFrame:
    """Leave out errors of one hit among many trials, and give errors the relative band of their ratio."""
    n_hits = part["n_trials"] - part["n_failed"] - part["n_misses"]
    is_measured = (n_hits > 1) | (part["n_trials"] == 1)
    columns: dict[str, Any] = {}
    for name, (column, _) in UNITS.items():
        for end in ("", "_low", "_high"):
            ratio = part[f"ratio_{name}{end}"].where(is_measured)
            columns |= {
                f"ratio_{name}{end}": ratio,
                f"rmse_{column}{end}": ratio / part[f"ratio_{name}"] * part[f"rmse_{column}"],
            }
    return part.assign(**columns)


def _missed(row: Mapping[Any, Any]) -> str:
    return with_failures(f"{row['n_misses'] / row['n_trials']:.3f}", row["n_failed"])


def _ratio_text(column: str, row: Mapping[Any, Any]) -> str:
    """Error over bound with its interval, two decimals below 10; empty without a hit."""
    ratio, low, high = (
        number_or_blank(row[f"{column}{end}"], "{:.2f}" if row[f"{column}{end}"] < 9.995 else "{:.0f}")
        for end in ("", "_low", "_high")
    )
    return f"{ratio} ({low}-{high})" if low else ratio


def _numbers(part: pd.DataFrame) -> dict[str, Any]:
    """Counts of one group, and errors and bounds of its trials with a hit."""
    broken, hits = failed(part), part[part["hit"]]
    found: dict[str, Any] = {
        "snr_gain_db": part["snr_gain_db"].iloc[0],
        "n_trials": len(part),
        "n_failed": int(broken.sum()),
        "n_misses": int((~broken & ~part["hit"]).sum()),
        "n_false": int(part["n_false"].sum()),
    }
    for dimension, error, bound in zip(DIMENSIONS, ERRORS, BOUNDS, strict=True):
        ratio, low, high = rms_interval((hits[error] / hits[bound]).to_numpy())
        unit = error.removeprefix("error_")
        found |= {
            f"rmse_{unit}": math.sqrt((hits[error] ** 2).mean()),
            f"bound_{unit}": part[bound].mean(),
            f"ratio_{dimension}": ratio,
            f"ratio_{dimension}_low": low,
            f"ratio_{dimension}_high": high,
        }
    return found


def _draw(scenario: Scenario, seed: int, trial: int) -> Scenario:
    """Scenario of a trial: the template's radio and region, one unit scatterer."""
    xyz, velocity = space_places(scenario, draw_place(scenario, trial, seed, MARGIN_CELLS)[None])
    return dataclasses.replace(scenario, scatterers=Scatterers(xyz, velocity, np.ones(1)))
