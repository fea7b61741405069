"""The study ``resolution``: two equal scatterers in ever smaller distance, and whether both are found.

They differ in one of range, velocity, u and w alone. What makes a pair easy
or hard is the phase between the two at the centre of resource grid and array:
in phase they look like one, so that every relative phase is a scene of its
own. The centre of the pair is drawn once a trial, the same for all scenes.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.bench.cells.statuses import failed
from isacbench.bench.studies.intervals import share_band
from isacbench.bench.studies.medians import summarise
from isacbench.bench.studies.study import ImagedScene, build_estimators, element_snrs_db
from isacbench.model.echo import central_phase
from isacbench.model.radio_coordinates import (
    DIMENSIONS,
    draw_place,
    gain_db,
    radio_places,
    rayleigh_cells,
    space_places,
)
from isacbench.model.scene import Scatterers, warned_before

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd
    from numpy.typing import NDArray

    from isacbench.bench.cells.cell import MeasuredImage
    from isacbench.bench.suites.resolution_kind import ResolutionSuite
    from isacbench.choices import Dimension
    from isacbench.model.scene import Scenario

MARGIN_CELLS = 0.5
"""Rayleigh cells between the farthest pair and the region's border."""

GROUP = ["template", "estimator", "params", "snr_gain_db", "dimension", "separation_cells"]


def resolution_scenes(suite: ResolutionSuite, scenarios: Mapping[str, Scenario]) -> list[ImagedScene]:
    """Plan one scene a scenario, dimension, distance and relative phase.

    Parameters
    ----------
    suite : ResolutionSuite
    scenarios : mapping of str to Scenario
        By name.

    Returns
    -------
    list of ImagedScene

    Raises
    ------
    InputError
        If a region has no room for the widest pair.
    """
    entries = build_estimators(suite)
    margin_cells = MARGIN_CELLS + max(suite.separations_cells) / 2
    scenes = []
    for template, dimension, cells, phase_deg in product(
        scenarios.values(), suite.dimensions, suite.separations_cells, suite.phases_deg
    ):
        name = f"{template.name}-{dimension}-{cells:g}-{phase_deg:g}deg"
        draw = partial(_draw, template, name, dimension, cells, phase_deg, margin_cells, suite.seed)
        with warned_before():
            renamed = dataclasses.replace(template, name=name)
        labels = {
            "template": template.name,
            "dimension": dimension,
            "separation_cells": cells,
            "phase_deg": phase_deg,
        }
        snr_db = element_snrs_db(suite, gain_db(draw(0)))
        measure = partial(measure_resolution, dimension)
        scenes.append(ImagedScene(suite, renamed, entries, snr_db, draw=draw, measure=measure, labels=labels))
    return scenes


def pair(
    template: Scenario,
    name: str,
    centre: NDArray[np.float64],
    dimension: Dimension,
    separation_cells: float,
    phase_deg: float,
) -> Scenario:
    """Scenario of two unit scatterers around a place.

    Parameters
    ----------
    template : Scenario
        Its radio and its region.
    name : str
        Of the new scenario.
    centre : ndarray of float64, shape (4,)
        Range in m, velocity in m/s, u and w of the middle.
    dimension : {"range", "velocity", "u", "w"}
        In which they differ.
    separation_cells : float
        By how many Rayleigh cells.
    phase_deg : float
        Phase between the echoes at the centre of resource grid and array.

    Returns
    -------
    Scenario
    """
    index = DIMENSIONS.index(dimension)
    places = np.stack([centre, centre])
    places[:, index] += np.array([-0.5, 0.5]) * separation_cells * rayleigh_cells(template)[index]
    xyz, velocity = space_places(template, places)
    scatterers = Scatterers(xyz, velocity, np.ones(2))
    scenario = dataclasses.replace(template, name=name, scatterers=scatterers)
    phase_rad = np.deg2rad([0.0, phase_deg]) - central_phase(scenario)
    with warned_before():
        return dataclasses.replace(scenario, scatterers=dataclasses.replace(scatterers, phase_rad=phase_rad))


def measure_resolution(dimension: Dimension, shot: MeasuredImage) -> dict[str, Any]:
    """Measure an image of two scatterers.

    Parameters
    ----------
    dimension : {"range", "velocity", "u", "w"}
        In which they differ.
    shot : MeasuredImage

    Returns
    -------
    dict
        ``resolved``, whether each scatterer has a point within half their
        distance along that dimension and within one Rayleigh cell in the
        others; ``n_false``, all points but one for each that has.
    """
    index, limits = DIMENSIONS.index(dimension), rayleigh_cells(shot.scenario)
    true = radio_places(shot.scenario, shot.scenario.scatterers)
    limits[index] = abs(true[1, index] - true[0, index]) / 2
    error = radio_places(shot.scenario, shot.cloud)[:, None] - true
    # Their neighbourhoods do not overlap, so that no point stands for both.
    found = (np.abs(error) < limits).all(axis=2).any(axis=0)
    return {"resolved": bool(found.all()), "n_false": len(shot.cloud) - int(found.sum())}


def summarise_resolution(records: pd.DataFrame) -> pd.DataFrame:
    """Probability of resolution of every estimator over the distance.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.

    Returns
    -------
    DataFrame
        One row for each template, estimator (with its parameters), SNR,
        dimension and distance: ``n_cells``, ``n_trials``, ``n_failed`` (not
        resolved either) and ``n_false``; ``resolved``, the share over all relative
        phases, ``resolved_worst`` that of the phase with the smallest,
        ``worst_phase_deg``, and ``resolved_in_phase`` that of phase 0 if it
        was run; the first and the last with 95 % intervals, ``..._low`` and
        ``..._high`` (Wilson) from five trials on; ``time_estimate_s_median``
        as `isacbench.bench.studies.medians.median_times` has it.
    """
    return summarise(records, GROUP, _numbers)


def _numbers(part: pd.DataFrame) -> dict[str, Any]:
    """Counts of one group, and the shares of its pairs that were found."""
    n_trials = part["trial"].nunique()
    phases = part.groupby("phase_deg")["resolved"].mean()
    found: dict[str, Any] = {
        "n_cells": len(part),
        "n_trials": n_trials,
        "n_failed": int(failed(part).sum()),
        "n_false": int(part["n_false"].sum()),
        "resolved_worst": phases.min(),
        "worst_phase_deg": phases.idxmin(),
    }
    in_phase = part[part["phase_deg"] == 0]
    for name, chosen in (("resolved", part), ("resolved_in_phase", in_phase)):
        resolved = chosen["resolved"]
        low, high = share_band(int(resolved.sum()), len(resolved), n_trials)
        found |= {name: resolved.mean(), f"{name}_low": low, f"{name}_high": high}
    return found


def _draw(
    template: Scenario,
    name: str,
    dimension: Dimension,
    separation_cells: float,
    phase_deg: float,
    margin_cells: float,
    seed: int,
    trial: int,
) -> Scenario:
    centre = draw_place(template, trial, seed, margin_cells)
    return pair(template, name, centre, dimension, separation_cells, phase_deg)
