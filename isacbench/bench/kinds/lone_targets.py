"""Absolute targets of lone scatterers: no false point, and errors that the Cramér-Rao bound explains.

Points and scatterers are matched one to one within a Rayleigh cell. A point
without a match is false: one that is a cell or more from every scatterer in
some coordinate, and the second one of a single scatterer.

A scatterer is resolvable if the joint bound of all scatterers of the scene,
which knows neither places nor amplitudes, is at most a tenth of a Rayleigh
cell in each coordinate. Of a scatterer alone it is a tenth at 11.8 dB after all
gain. Below that, the noise in one of some million cells is as strong, and
no estimator finds the scatterer without false points.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from isacbench.bench.cells.cell import MeasuredImage
from isacbench.dsp.bounds import joint_bound
from isacbench.model.echo import echo_parameters
from isacbench.model.radio_coordinates import radio_places, rayleigh_cells
from isacbench.model.scene import Scenario

Floats = NDArray[np.float64]

RESOLVABLE_CELLS = 0.1
"""Largest bound of a resolvable scatterer, a standard deviation, in Rayleigh cells."""

MOST_DEVIATIONS = 3.0
"""Largest error of a resolved scatterer in standard deviations of the bound."""


def measure_lone_scatterers(shot: MeasuredImage) -> dict[str, Any]:
    """Measure an image of lone scatterers.

    Returns
    -------
    dict
        ``n_resolvable``; ``n_resolved``, those of them whose point is within 3
        standard deviations of the bound in range, velocity, u and w; and
        ``n_false``, the points without a scatterer of their own.
    """
    scenario = shot.scenario
    bound = scene_bound(scenario, shot.snr_db)
    resolvable = np.all(bound <= RESOLVABLE_CELLS * rayleigh_cells(scenario), axis=1)
    error = radio_places(scenario, shot.cloud)[:, None] - radio_places(scenario, scenario.scatterers)
    points, scatterers = match_points(error / rayleigh_cells(scenario))
    is_exact = np.all(np.abs(error[points, scatterers]) <= MOST_DEVIATIONS * bound[scatterers], axis=1)
    return {
        "n_resolvable": int(resolvable.sum()),
        "n_resolved": int((is_exact & resolvable[scatterers]).sum()),
        "n_false": len(shot.cloud) - len(points),
    }


def scene_bound(scenario: Scenario, snr_db: float) -> Floats:
    """Cramér-Rao bound of all scatterers of a scene together, without errors of the array.

    Parameters
    ----------
    scenario : Scenario
        Its scatterers have amplitudes other than 0.
    snr_db : float
        Per resource element and virtual element.

    Returns
    -------
    ndarray of float64, shape (n, 4)
        Standard deviations of range in m, velocity in m/s, u and w; infinite where
        scatterers cannot be told apart.
    """
    gain = echo_parameters(scenario).gain
    noise_power = float(np.sum(np.abs(gain) ** 2)) / 10 ** (snr_db / 10) * scenario.array.n_turns
    range_m, velocity_mps, u, w = radio_places(scenario, scenario.scatterers).T
    bound = joint_bound(scenario.system, scenario.array.shape, range_m, velocity_mps, u, w, gain, noise_power)
    return np.stack([bound.range_m, bound.velocity_mps, bound.u, bound.w], axis=1)


def match_points(error_cells: Floats) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Match points and scatterers one to one: as many as possible, then at the least sum of distances.

    Parameters
    ----------
    error_cells : ndarray of float64, shape (n_points, n_scatterers, 4)
        Differences of their coordinates in Rayleigh cells; a pair is possible if all are below 1.

    Returns
    -------
    points, scatterers : ndarray of int, shape (n,)
        Indices of the pairs.
    """
    is_possible: NDArray[np.bool_] = np.asarray(np.all(np.abs(error_cells) < 1, axis=2))
    distance = np.linalg.norm(error_cells, axis=2)
    # A possible pair is at most 2 cells long: no sum of them is worth an impossible one.
    impossible = 2.0 * (1 + min(is_possible.shape))
    points, scatterers = linear_sum_assignment(np.where(is_possible, distance, impossible))
    kept = is_possible[points, scatterers]
    return points[kept], scatterers[kept]
