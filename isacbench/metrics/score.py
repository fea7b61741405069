"""Scores of an estimated cloud, and the table that describes them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from isacbench.cores import one_blas_thread
from isacbench.errors import InputError, unknown_name
from isacbench.metrics.cloud_scores import RADIUS_M, pair_scores
from isacbench.metrics.deviation import pair_deviation
from isacbench.metrics.geometry import CloudPair
from isacbench.metrics.repository import repository_deviation
from isacbench.model.cloud import PointCloud

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from isacbench.model.region import Region

METRIC_VERSION = 1
"""Version of the scores: scores of different versions are not compared."""


@dataclass(frozen=True)
class ScoreColumn:
    """Meaning of a score: enough to label an axis and to rank by it.

    Attributes
    ----------
    name : str
        Key in the answer of `score`.
    description : str
        One line with the unit, if any, in brackets.
    better : {"lower", "higher", "neither"}
        Direction that is better.
    """

    name: str
    description: str
    better: Literal["lower", "higher", "neither"] = "lower"


def _table(*columns: ScoreColumn) -> dict[str, ScoreColumn]:
    """Key columns by their name, in order."""
    return {column.name: column for column in columns}


_COUNTS = (
    ScoreColumn("n_true", "true scatterers", "neither"),
    ScoreColumn("n_estimated", "estimated points", "neither"),
)

METRICS: dict[str, dict[str, ScoreColumn]] = {
    "paper": _table(
        *_COUNTS,
        ScoreColumn("hausdorff_xy_m", "Hausdorff distance of the xy projections [m]"),
        ScoreColumn("hausdorff_xz_m", "Hausdorff distance of the xz projections [m]"),
        ScoreColumn("hausdorff_yz_m", "Hausdorff distance of the yz projections [m]"),
        ScoreColumn("density", "relative error of the number of points"),
        ScoreColumn("velocity_nmse", "normalised mean square error of the velocity"),
        ScoreColumn("deviation", "imaging deviation: sum of the three Hausdorff distances, density and NMSE"),
        ScoreColumn("chamfer_m", "chamfer distance, mean of both directions [m]"),
        ScoreColumn("gospa_m", "GOSPA distance with c = the radius, p = 2, α = 2 [m]"),
        ScoreColumn("precision", "share of estimated points within the radius of a scatterer", "higher"),
        ScoreColumn("recall", "share of true scatterers within the radius of a point", "higher"),
    ),
    "repository": _table(
        *_COUNTS,
        ScoreColumn("position", "Hausdorff distances of x, of y and of the xz projections, summed [m]"),
        ScoreColumn("velocity", "mean standard deviation of the paired distinct velocities [m/s]"),
        ScoreColumn("density", "relative error of the number of points"),
        ScoreColumn("deviation", "deviation of the published code: sum of position, velocity and density"),
    ),
}
"""Score columns of every metric, by metric and name, in the order of the answer of `score`."""


def score(
    truth: PointCloud | ArrayLike,
    estimate: PointCloud | ArrayLike,
    metric: str = "paper",
    *,
    region: Region | None = None,
    velocity_bin_mps: float | None = None,
    radius_m: float = RADIUS_M,
) -> dict[str, float]:
    """Score an estimated cloud against the true one.

    Parameters
    ----------
    truth : PointCloud or array_like, shape (n, 3), (n, 4) or (n, 5)
        True scatterers, at least one; columns x, y, z in m, v in m/s, power.
    estimate : PointCloud or array_like, shape (m, 3), (m, 4) or (m, 5)
        Estimated points, possibly none.
    metric : {"paper", "repository"}
        The paper's imaging deviation with further scores, or the deviation
        that the published code computes.
    region : Region or None
        Region of the scenario, which decides the scores of an empty estimate;
        None takes all that a radar of the paper's Table I could report.
    velocity_bin_mps : float or None
        Velocity bin in m/s, the velocity unit of a static scene in the metric
        ``paper``; None takes that of the paper's Table I.
    radius_m : float
        Distance in m within which a point counts as one of a scatterer, in
        precision, recall and GOSPA; a scenario has its own, ``radius_m``.

    Returns
    -------
    dict of str to float
        The columns that `METRICS` describes, all finite; counts are ints. Of
        very dense clouds ``gospa_m`` is NaN, with an `InputWarning`. Where a cloud
        has no velocities, ``velocity_nmse`` (``velocity`` of ``repository``) and
        ``deviation`` are NaN.

    Raises
    ------
    InputError
        If the metric is unknown, the truth is empty, a cloud is malformed, or
        the radius is no positive number.

    Examples
    --------
    >>> truth = [[0.0, 0.0, 0.0, 2.0], [0.0, 3.0, 4.0, 2.0]]
    >>> scores = score(truth, truth[:1])
    >>> scores["hausdorff_yz_m"], scores["density"], scores["recall"]
    (5.0, 0.5, 0.5)
    """
    if metric not in METRICS:
        raise unknown_name("metric", str(metric), METRICS)
    pair = CloudPair(_as_cloud(truth, "truth"), _as_cloud(estimate, "estimate"))
    parts: tuple[object, ...]
    with one_blas_thread():
        if metric == "repository":
            parts = (repository_deviation(pair.truth, pair.estimate, region),)
        else:
            parts = pair_deviation(pair, region, velocity_bin_mps), pair_scores(pair, region, radius_m)
    scores: dict[str, float] = {"n_true": len(pair.truth), "n_estimated": len(pair.estimate)}
    for name in list(METRICS[metric])[len(scores) :]:
        scores[name] = next(getattr(part, name) for part in parts if hasattr(part, name))
    return scores


def _as_cloud(values: PointCloud | ArrayLike, name: str) -> PointCloud:
    """Take a cloud as it is, anything else as an array or table of x, y, z, v and perhaps power."""
    if isinstance(values, PointCloud):
        return values
    try:
        return PointCloud.from_array(values)
    except ValueError as error:
        raise InputError(f"{name}: {error}") from error
