"""Scores of points matched one to one with the truth, merged where no radio could tell scatterers apart."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial import cKDTree

from isacbench.checked_arrays import Floats
from isacbench.errors import InputError, InputWarning
from isacbench.metrics.assignment import Pairs, cheapest, connected_pieces, most_pairs, near_pairs, pair_gospa
from isacbench.metrics.descriptions import ScoreColumn
from isacbench.metrics.geometry import CloudPair
from isacbench.model.cloud import PointCloud
from isacbench.model.radio_coordinates import radio_places, rayleigh_cells
from isacbench.model.scene import Scenario

MERGED_CELLS = 0.5
"""Scatterers that fit into half a Rayleigh cell in all four coordinates count as one."""

MOST_MERGED = 8192
"""Scatterers in one piece that are merged: their distances take 0.3 GB."""

RADII_M: Floats = np.geomspace(0.1, 4.0, 17)
"""Radii of the F-score's curve: evenly spaced in their logarithm, a factor of 1.26 apart."""

VELOCITY_TIE = 1e-6
"""Weight of velocities in a matching: it decides only where places do not."""


class Curve(NamedTuple):
    """Precision, recall and F-score over the radius.

    Attributes
    ----------
    radius_m : ndarray of float64, shape (n,)
    precision, recall, f_score : ndarray of float64, shape (n,)
    """

    radius_m: Floats
    precision: Floats
    recall: Floats
    f_score: Floats

    @property
    def area(self) -> float:
        """Mean of the F-score over the logarithm of the radius (trapezoidal rule)."""
        axis = np.log(self.radius_m)
        return float(np.trapezoid(self.f_score, axis) / (axis[-1] - axis[0]))


@dataclass(frozen=True)
class OneToOne:
    """One-to-one F-score at the radius, its area over the radius, velocity error, GOSPA's parts and OSPA."""

    name: ClassVar[str] = "points"
    version: ClassVar[int] = 1
    columns: ClassVar[tuple[ScoreColumn, ...]] = (
        ScoreColumn("f_score", "F-score of points matched one to one within the radius", "", "higher", 0.0),
        ScoreColumn("matched_precision", "share of estimated points matched one to one", "", "higher", 0.0),
        ScoreColumn("matched_recall", "share of true scatterers matched one to one", "", "higher", 0.0),
        ScoreColumn("velocity_error_mps", "root mean square velocity error of matched points", "m/s"),
        ScoreColumn("f_score_area", "mean F-score over radii from 0.1 to 4 m", "", "higher", 0.0),
        ScoreColumn("gospa_skill", "skill 1 - (GOSPA / GOSPA of an empty image)²", "", "higher", 0.0),
        ScoreColumn(
            "gospa_localisation", "part of GOSPA² of the distances of matched points", "", "lower", 0.0
        ),
        ScoreColumn("gospa_missed", "part of GOSPA² of missed scatterers", "", "lower", 1.0),
        ScoreColumn("gospa_false", "part of GOSPA² of false points", "", "lower", 0.0),
        ScoreColumn("ospa_m", "OSPA distance with c = the radius, p = 2", "m"),
    )

    def score(self, pair: CloudPair) -> dict[str, float]:
        """Score a pair.

        Parameters
        ----------
        pair : CloudPair
            Without a scenario the truth is not merged, with an `InputWarning`.

        Returns
        -------
        dict of str to float
            NaN where a cloud is too dense to be matched or merged (the area at 4 m, the others at the
            radius), and for the velocity error if velocities are unknown. Without matched points the
            velocity error is the largest that the region allows.
        """
        gospa = pair.remembered(pair_gospa)
        localisation, missed, false = gospa.shares
        found = {
            "gospa_skill": 1 - localisation - missed - false,
            "gospa_localisation": localisation,
            "gospa_missed": missed,
            "gospa_false": false,
            "ospa_m": gospa.ospa_m,
        }
        truth, inside, _ = pair.remembered(_near_merged)
        if inside is None:
            return {**dict.fromkeys((column.name for column in self.columns), math.nan), **found}
        n_matched, velocity_error_mps = _nearest_matching(pair, truth, inside)
        n_true, n_estimated = len(truth), len(pair.estimate)
        return {
            "f_score": 2 * n_matched / (n_true + n_estimated),
            "matched_precision": n_matched / max(n_estimated, 1),
            "matched_recall": n_matched / n_true,
            "velocity_error_mps": velocity_error_mps,
            "f_score_area": score_curve(pair).area,
            **found,
        }


def score_curve(pair: CloudPair) -> Curve:
    """Precision, recall and F-score of a pair, matched one to one, over radii from 0.1 to 4 m.

    Returns
    -------
    Curve
        NaN where a cloud is too dense.
    """
    truth, _, near = pair.remembered(_near_merged)
    if near is None:
        return Curve(RADII_M, *np.full((3, RADII_M.size), math.nan))
    n_true, n_estimated = len(truth), len(pair.estimate)
    # Once all are matched, further pairs change nothing, and to match them takes longest.
    n_matched = np.full(RADII_M.size, min(n_true, n_estimated))
    for place, radius_m in enumerate(RADII_M.tolist()):
        n_matched[place] = n = most_pairs(near.take(near.squared_m2 <= radius_m**2))
        if n == n_matched[-1]:
            break
    shares = n_matched / max(n_estimated, 1), n_matched / n_true, 2 * n_matched / (n_true + n_estimated)
    return Curve(RADII_M, *shares)


@lru_cache(maxsize=4)
def merged_truth(scenario: Scenario) -> PointCloud:
    """Merge scatterers that fit into half a Rayleigh cell in range, velocity, u and w: complete linkage.

    Unlike cells of a lattice, the groups do not depend on where the borders of cells lie.

    Returns
    -------
    PointCloud
        Means of x, y, z and v, sums of the power.

    Raises
    ------
    InputError
        If more than `MOST_MERGED` scatterers hang together.

    References
    ----------
    D. Defays, "An efficient algorithm for a complete link method", Comput. J. 20 (1977).
    """
    truth = scenario.truth
    places = radio_places(scenario, truth) / (MERGED_CELLS * rayleigh_cells(scenario))
    group, first = np.zeros(len(truth), dtype=np.intp), 1
    for members in connected_pieces(places):
        if members.size > MOST_MERGED:
            raise InputError(
                f"scenario {scenario.name}: {members.size} scatterers hang together; allowed are at most "
                f"{MOST_MERGED} to be merged"
            )
        group[members] = first
        if members.size > 1:
            tree = linkage(places[members], "complete", metric="chebyshev")
            group[members] += fcluster(tree, 1.0, "distance") - 1
        first = int(group[members].max()) + 1
    n_points = np.bincount(group)[1:]
    x, y, z, v, power = (np.bincount(group, column)[1:] for column in truth.to_array().T)
    return PointCloud(np.column_stack([x, y, z]) / n_points[:, None], v / n_points, power)


def _near_merged(pair: CloudPair) -> tuple[PointCloud, Pairs | None, Pairs | None]:
    """Merge the truth, and pair it with the estimate within the radius, and up to the curve's last radius."""
    truth = pair.truth
    if pair.scenario is None:
        warnings.warn(
            "the truth is not merged to what a radio could tell apart, because no scenario says what it is: "
            "F-scores count every true point; give a scenario for the truth to merge it",
            InputWarning,
            stacklevel=2,
        )
    else:
        try:
            truth = merged_truth(pair.scenario)
        except InputError as error:
            warnings.warn(f"F-scores are left out (NaN): {error}", InputWarning, stacklevel=2)
            return truth, None, None
    tree = cKDTree(truth.xyz)
    near = near_pairs(tree, pair.estimate_tree, RADII_M[-1], "f_score_area")
    if near is None or pair.radius_m > RADII_M[-1]:
        return truth, near_pairs(tree, pair.estimate_tree, pair.radius_m, "F-score"), near
    return truth, near.take(near.squared_m2 <= pair.radius_m**2), near


def _nearest_matching(pair: CloudPair, truth: PointCloud, inside: Pairs) -> tuple[int, float]:
    """Size of the largest matching within the radius, and the velocity error of the nearest one of these."""
    if not inside.i.size:
        speeds = (0.0, 0.0) if pair.region is None else pair.region.speed_mps
        worst_mps = max(float(np.ptp([*truth.velocity, *speeds, 0.0])), pair.velocity_bin_mps)
        return 0, worst_mps if pair.has_velocities else math.nan
    errors_mps = pair.estimate.velocity[inside.j] - truth.velocity[inside.i]
    cost = inside.squared_m2 / pair.radius_m**2
    if pair.has_velocities:
        cost = cost + VELOCITY_TIE * (errors_mps / (float(np.abs(errors_mps).max()) or 1.0)) ** 2
    chosen = cheapest(inside, cost, math.inf)
    return chosen.size, math.sqrt(float(np.square(errors_mps[chosen]).mean()))
