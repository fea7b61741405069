"""The study ``efficiency``: one scatterer anywhere, and how far errors lie above the Cramér-Rao bound.

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
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.bench.cells.statuses import failed
from isacbench.bench.studies.intervals import rms_interval
from isacbench.bench.studies.medians import summarise
from isacbench.bench.studies.study import ImagedScene, build_estimators, element_snrs_db
from isacbench.bench.suites.efficiency_kind import BOUNDS, ERRORS
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
    from isacbench.model.scene import Scenario

MARGIN_CELLS = 0.5
"""Rayleigh cells between a scatterer and the region's border: beyond it errors would be cut off."""

GROUP = ["scenario", "estimator", "params", "snr_db"]


def efficiency_scenes(suite: Suite, scenarios: Mapping[str, Scenario]) -> list[ImagedScene]:
    """Plan one scene a scenario: one scatterer in its region.

    Parameters
    ----------
    suite : Suite
    scenarios : mapping of str to Scenario
        By name.

    Returns
    -------
    list of ImagedScene

    Raises
    ------
    InputError
        If a region has no room for the scatterer, or the noise is the transmitter's.
    """
    entries = build_estimators(suite)
    scenes = []
    for scenario in scenarios.values():
        scenario.require_default("the Cramér-Rao bound", "noise")
        draw = partial(_draw, scenario, suite.seed)
        snr_db = element_snrs_db(suite, gain_db(draw(0)))
        scenes.append(ImagedScene(suite, scenario, entries, snr_db, draw=draw, measure=measure_efficiency))
    return scenes


def measure_efficiency(shot: MeasuredImage) -> dict[str, Any]:
    """Measure an image of one scatterer.

    Parameters
    ----------
    shot : MeasuredImage

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


def summarise_efficiency(records: pd.DataFrame) -> pd.DataFrame:
    """Root mean square errors over the bound, of every estimator at every SNR.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.

    Returns
    -------
    DataFrame
        One row for each scenario, estimator (with its parameters) and SNR:
        ``snr_gain_db``; the counts ``n_trials``, ``n_failed``, ``n_misses``
        (without failures) and ``n_false``; for each of range, velocity, u
        and w ``rmse_<x>`` and ``bound_<x>`` in its unit and ``ratio_<x>``
        of the two with its 95 % interval ``ratio_<x>_low``,
        ``ratio_<x>_high``, all of the trials with a hit, the interval of five
        or more; ``time_estimate_s_median`` as
        `isacbench.bench.studies.medians.median_times` has it.
    """
    return summarise(records, GROUP, _numbers)


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
