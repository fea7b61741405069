"""The kind ``resolution``: two equal scatterers in ever smaller distance, and whether both are found.

They differ in one of range, velocity, u and w alone. What makes a pair easy
or hard is the phase between the two at the centre of resource grid and array:
in phase they look like one, so that every relative phase is a scene of its
own. The centre of the pair is drawn once a trial, the same for all scenes.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from functools import partial
from itertools import product
from typing import Annotated, Any, ClassVar, get_args

import numpy as np
import pandas as pd
from pydantic import Field

from isacbench import charts
from isacbench.bench import statistics
from isacbench.bench.cells.images import Image
from isacbench.bench.cells.rows import failed
from isacbench.bench.cells.task import ImagingTask, build_estimators
from isacbench.bench.kinds import kind
from isacbench.bench.kinds.efficiency import TITLES
from isacbench.bench.kinds.kind import NO_SCENARIOS, SNR_GAIN, Kind, Scenarios
from isacbench.bench.suites.suite import Listed, Suite
from isacbench.charts import VARIANT, Axis, Chart, ChartGroup, Column, Table
from isacbench.checked_arrays import Floats
from isacbench.choices import Dimension
from isacbench.model import radio_coordinates
from isacbench.model.echo import central_phase
from isacbench.model.radio_coordinates import DIMENSIONS, radio_places, rayleigh_cells, space_places
from isacbench.model.scene import Scatterers, Scenario, no_input_warnings

Separation = Annotated[float, Field(gt=0, le=10)]
Phase = Annotated[float, Field(gt=-360, lt=360)]

MARGIN_CELLS = 0.5
"""Rayleigh cells between the farthest pair and the region's border."""

GROUP = ["template", *VARIANT, "snr_gain_db", "dimension", "separation_cells"]
PLACE = ["template", "snr_gain_db"]


class ResolutionSuite(Suite):
    """Suite of the kind ``resolution``.

    Attributes
    ----------
    dimensions : tuple of {"range", "velocity", "u", "w"}
        Dimensions in which pairs of scatterers differ, one at a time.
    separations_cells : tuple of float
        Distances in Rayleigh cells.
    phases_deg : tuple of float
        Phases between the two echoes at the centre of resource grid and array.
    """

    kind: str = "resolution"
    dimensions: Listed[Dimension] = get_args(Dimension)
    separations_cells: Listed[Separation]
    phases_deg: Listed[Phase] = (0.0,)


class ResolutionKind(Kind):
    """Share of pairs of scatterers that are found, over their distance."""

    name = "resolution"
    suite = ResolutionSuite
    columns: ClassVar = {
        **SNR_GAIN,
        **dict.fromkeys(["template", "dimension"], ""),
        **dict.fromkeys(["separation_cells", "phase_deg"], math.nan),
        "resolved": False,
        "n_false": 0,
    }
    better: ClassVar = {
        "resolved": "higher",
        **dict.fromkeys([*SNR_GAIN, "separation_cells", "phase_deg"], "neither"),
    }

    def tasks(self, suite: ResolutionSuite, scenarios: Scenarios) -> list[ImagingTask]:
        """Plan one task a scenario, dimension, distance and relative phase."""
        entries, tasks = build_estimators(suite), []
        pairs = product(suite.dimensions, suite.separations_cells, suite.phases_deg)
        for template, (dimension, cells, phase_deg) in product(scenarios.values(), pairs):
            own: dict[str, Any] = {"dimension": dimension, "separation_cells": cells, "phase_deg": phase_deg}
            name = f"{template.name}-{dimension}-{cells:g}-{phase_deg:g}deg"
            with no_input_warnings():
                scenario = dataclasses.replace(template, name=name)
            make, measure = partial(pair, template, name, **own), partial(measure_resolution, dimension)
            draw = partial(_draw, suite, template, make)
            labels = {"template": template.name, **own}
            tasks.append(ImagingTask(suite, scenario, entries, draw=draw, measure=measure, labels=labels))
        return tasks

    def summary(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Probability of resolution of every estimator over the distance.

        One row for each template, estimator, SNR, dimension and distance: ``n_cells``, ``n_trials``,
        ``n_failed`` (not resolved either) and ``n_false``; ``resolved``, the share over all relative phases,
        ``resolved_worst`` that of the phase with the smallest, ``worst_phase_deg``, and ``resolved_in_phase``
        that of phase 0 if it was run; the first and the last with 95 % intervals, ``..._low`` and
        ``..._high`` (Wilson) from five trials on; ``time_estimate_s_median``.
        """
        return statistics.summarise(rows, GROUP, _numbers)

    def tables(self, rows: pd.DataFrame) -> list[Table]:
        """Share of pairs that were found, estimators over dimension and distance: a table a place and SNR."""
        labels, tables = kind.labels_of(rows), kind.number_tables(rows)
        times_s = statistics.median_times(rows, [*PLACE, *VARIANT])[f"{statistics.TIME}_median"]
        columns = [
            Column("pairs: differ in", "dimension", part=0),
            Column("distance: cells", "separation_cells", "{:g}", part=0),
        ]
        for key, part in self.summary(rows).groupby(PLACE, sort=False):
            title = (
                f"{key[0]}, {key[1]:.4g} dB after gain: share of pairs found, over all relative phases / "
                f"at the worst one; {statistics.time_words(rows)}"
            )
            lines = charts.spread_rows(part, ["dimension", "separation_cells"], VARIANT)
            headings = {variant: labels[variant] for variant in charts.variants_in(part)}
            own_s = ((one, times_s.get((*key, *one))) for one in headings)
            lines.append({"dimension": "time [ms]"} | {one: f"{1e3 * s:.1f}" for one, s in own_s if s})
            tables.append(Table(title, [*columns, *charts.spread_columns(headings, _shares_text)], lines))
        return tables

    def charts(self, rows: pd.DataFrame, scenarios: Scenarios = NO_SCENARIOS) -> list[ChartGroup]:
        """Share of pairs that are found over their distance, a chart a dimension."""
        summary, lines, in_phase, groups = self.summary(rows), kind.lines_of(rows), {}, []
        for variant, line in lines.items():
            style = dataclasses.replace(line.style, dash="dash", symbol="")
            in_phase[variant] = line._replace(label=f"{line.label}, in phase", style=style)
        x = Axis("distance [Rayleigh cells]", log=True)
        y = Axis("share of pairs found", limits=charts.SHARE_LIMITS)
        for template, stem, of_template in kind.title_stems(summary, "template"):
            for snr_db, part in of_template.groupby("snr_gain_db"):
                panels = []
                for name, own in part.groupby("dimension", sort=False):
                    series = charts.line_series(own, lines, "separation_cells", "resolved", "resolved")
                    if own["resolved_in_phase"].notna().any():
                        series += charts.line_series(own, in_phase, "separation_cells", "resolved_in_phase")
                    panels.append(Chart(TITLES[str(name)], x, y, series))
                title = (
                    f"{template}: two equal scatterers, each found within half their distance, "
                    f"{snr_db:.4g} dB after gain; {statistics.trials_and_band(part['n_trials'].max())}"
                )
                suffix = f"-{snr_db:g}dB" if summary["snr_gain_db"].nunique() > 1 else ""
                groups.append(ChartGroup(f"resolution-{stem}{suffix}", title, panels))
        return groups


def _draw(suite: ResolutionSuite, template: Scenario, make: Callable[..., Scenario], trial: int) -> Scenario:
    """Scenario of a trial: a pair around a place that leaves room for the farthest one."""
    margin_cells = MARGIN_CELLS + max(suite.separations_cells) / 2
    return make(centre=radio_coordinates.draw_place(template, trial, suite.seed, margin_cells))


def pair(
    template: Scenario,
    name: str,
    centre: Floats,
    dimension: Dimension,
    separation_cells: float,
    phase_deg: float,
) -> Scenario:
    """Scenario of two unit scatterers around a place, `centre`: range in m, velocity in m/s, u and w.

    They differ in one dimension by so many Rayleigh cells; the phase is that between the echoes at the centre
    of resource grid and array.
    """
    index = DIMENSIONS.index(dimension)
    places = np.stack([centre, centre])
    places[:, index] += np.array([-0.5, 0.5]) * separation_cells * rayleigh_cells(template)[index]
    scatterers = Scatterers(*space_places(template, places), np.ones(2))
    scenario = dataclasses.replace(template, name=name, scatterers=scatterers)
    phase_rad = np.deg2rad([0.0, phase_deg]) - central_phase(scenario)
    with no_input_warnings():
        return dataclasses.replace(scenario, scatterers=dataclasses.replace(scatterers, phase_rad=phase_rad))


def measure_resolution(dimension: Dimension, image: Image) -> dict[str, Any]:
    """Measure an image of two scatterers: whether both are resolved, and all points but one for each.

    One is resolved by a point within half their distance along that dimension and within one Rayleigh cell
    in the others.
    """
    index, limits = DIMENSIONS.index(dimension), rayleigh_cells(image.scenario)
    true = radio_places(image.scenario, image.scenario.scatterers)
    limits[index] = abs(true[1, index] - true[0, index]) / 2
    error = radio_places(image.scenario, image.cloud)[:, None] - true
    # Their neighbourhoods do not overlap, so that no point stands for both.
    is_resolved = (np.abs(error) < limits).all(axis=2).any(axis=0)
    return {"resolved": bool(is_resolved.all()), "n_false": len(image.cloud) - int(is_resolved.sum())}


def _shares_text(entry: Mapping[Any, Any]) -> str:
    """Share of resolved pairs, mean and worst phase, and what failed."""
    return charts.with_failures(f"{entry['resolved']:.2f} / {entry['resolved_worst']:.2f}", entry["n_failed"])


def _numbers(part: pd.DataFrame) -> dict[str, Any]:
    """Counts of one group, and the shares of its pairs that were found."""
    n_trials = part["trial"].nunique()
    phases = part.groupby("phase_deg")["resolved"].mean()
    numbers: dict[str, Any] = {
        "n_cells": len(part),
        "n_trials": n_trials,
        "n_failed": int(failed(part).sum()),
        "n_false": int(part["n_false"].sum()),
        "resolved_worst": phases.min(),
        "worst_phase_deg": phases.idxmin(),
    }
    in_phase = part[part["phase_deg"] == 0]
    for name, chosen in (("resolved", part), ("resolved_in_phase", in_phase)):
        numbers |= statistics.share_columns(name, int(chosen["resolved"].sum()), len(chosen), n_trials)
    return numbers
