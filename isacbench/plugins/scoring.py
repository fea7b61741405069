"""Scores of an image by registered metrics, and the columns that describe them."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from numpy.typing import ArrayLike

from isacbench.cores import one_blas_thread
from isacbench.errors import InputError, InputWarning
from isacbench.metrics.descriptions import ANY_KIND, ScoreColumn, expanded, object_kind
from isacbench.metrics.geometry import CloudPair
from isacbench.metrics.paper import Paper
from isacbench.model.cloud import PointCloud
from isacbench.model.region import Region
from isacbench.model.scene import Scenario
from isacbench.plugins.contracts import Metric
from isacbench.plugins.discovery import error_place
from isacbench.plugins.registry import build_metric, canonical_params, python_number
from isacbench.process_state import plugin_output

PAPER = Paper.name
"""Metric that every row of a run is scored by."""

COUNTS = (
    ScoreColumn("n_true", "true scatterers", "", "neither"),
    ScoreColumn("n_estimated", "estimated points", "", "neither", 0.0),
)


def score(
    truth: Scenario | PointCloud | ArrayLike,
    estimate: PointCloud | ArrayLike,
    metric: str | Metric = PAPER,
    *,
    region: Region | None = None,
    velocity_bin_mps: float | None = None,
    radius_m: float | None = None,
) -> dict[str, float]:
    """Score an estimated cloud against the true one.

    Parameters
    ----------
    truth : Scenario, PointCloud or array_like, shape (n, 3), (n, 4) or (n, 5)
        True scatterers, at least one; columns x, y, z in m, v in m/s, power. Of a scenario also its region,
        velocity bin and radius are taken where they are not given, and metrics know its radio and objects.
    estimate : PointCloud or array_like, shape (m, 3), (m, 4) or (m, 5)
        Estimated points, possibly none.
    metric : str or Metric
        Name of a registered metric, ``name[param=value,...]``, or a metric: ``paper``, the paper's imaging
        deviation with further scores; ``repository``, the deviation that the published code computes;
        ``points``, ``occupancy``, ``objects``, or one of a plugin.
    region : Region or None
        Region of the scenario, which decides the scores of an empty estimate;
        None takes all that a radar of the paper's Table I could report.
    velocity_bin_mps : float or None
        Velocity bin in m/s, the velocity unit of a static scene in the metric
        ``paper``; None takes that of the paper's Table I.
    radius_m : float or None
        Distance in m within which a point counts as one of a scatterer, in
        precision, recall and GOSPA; None takes 1 m.

    Returns
    -------
    dict of str to float
        ``n_true``, ``n_estimated``, and the columns of the metric. Counts are ints. Of
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
    chosen = build_metric(metric) if isinstance(metric, str) else metric
    cloud = _as_cloud(estimate, "estimate")
    if isinstance(truth, Scenario):
        pair = CloudPair.of(truth, cloud)
    else:
        pair = CloudPair(_as_cloud(truth, "truth"), cloud)
    given: dict[str, Any] = {"region": region, "velocity_bin_mps": velocity_bin_mps, "radius_m": radius_m}
    pair = replace(pair, **{name: value for name, value in given.items() if value is not None})
    if not (len(pair.truth) or takes_empty_truth(chosen)):
        named = "truth" if pair.scenario is None else f"scenario {pair.scenario.name}"
        raise InputError(f"{named}: it has no scatterers; metric {chosen.name} takes at least one")
    if lack := lacks_of(chosen, pair.scenario):
        warnings.warn(f"metric {chosen.name}: {lack}; its scores are NaN", InputWarning, stacklevel=2)
    return {**_counts(pair), **metric_scores(chosen, pair)}


def _counts(pair: CloudPair) -> dict[str, int]:
    """Numbers of points, in the columns `COUNTS`."""
    return {"n_true": len(pair.truth), "n_estimated": len(pair.estimate)}


def lacks_of(metric: Metric, scenario: Scenario | None) -> str:
    """Say what a scenario lacks for a metric; empty where it lacks nothing."""
    lacks = getattr(metric, "lacks", None)
    return "" if lacks is None else str(lacks(scenario))


def takes_empty_truth(metric: Metric) -> bool:
    """Tell whether a metric scores images of scenes without scatterers, which others have no score for."""
    return bool(getattr(metric, "scores_empty_truth", False))


@plugin_output()
@one_blas_thread()
def metric_scores(metric: Metric, pair: CloudPair) -> dict[str, float]:
    """Score a pair by a metric: a value for each column, in order; NaN where the scenario lacks something.

    A metric that raises an exception, or returns other columns than it describes or what is no number, is
    refused with an `InputError`.
    """
    known = expanded(metric.columns, () if pair.scenario is None else object_kinds(pair.scenario))
    if lacks_of(metric, pair.scenario) or not (len(pair.truth) or takes_empty_truth(metric)):
        return dict.fromkeys(known, math.nan)
    try:
        found = dict(metric.score(pair))
    except (InputError, MemoryError):
        raise
    except Exception as error:
        place = error_place(error, type(metric).__module__)
        what = f"score() raised {type(error).__name__}: {error}{f' ({place})' if place else ''}"
        raise InputError(f"metric {metric.name}: {what}") from error
    always = {column.name for column in metric.columns if ANY_KIND not in column.name}
    if (always - found.keys()) | (found.keys() - known.keys()):
        raise InputError(
            f"metric {metric.name}: score() returned the scores {', '.join(found)}; needed are those of its "
            f"columns, {', '.join(known)}"
        )
    for name, value in found.items():
        found[name] = number = python_number(value)
        if isinstance(number, bool) or not isinstance(number, (int, float)):
            raise InputError(
                f"metric {metric.name}: score() returned {name} = {value!r}; allowed are numbers"
            )
    return {name: found.get(name, math.nan) for name in known}


@lru_cache(maxsize=64)
def object_kinds(scenario: Scenario) -> tuple[str, ...]:
    """Kinds of objects of a scenario, sorted."""
    return tuple(sorted({object_kind(name) for name in set(scenario.scatterers.objects)} - {""}))


@dataclass(frozen=True)
class Metrics:
    """Metrics that every image of a run is scored by, ``paper`` first.

    A column that an earlier metric has, too, is called ``<metric>_<column>``.

    Attributes
    ----------
    further : tuple of Metric
        Beside ``paper``.
    """

    further: tuple[Metric, ...] = ()

    @classmethod
    def of(cls, specs: Iterable[str]) -> Metrics:
        """Build registered metrics, as ``name[param=value,...]``; none twice."""
        built = [build_metric(spec) for spec in specs]
        names = [PAPER, *(metric.name for metric in built)]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"metrics: {name!r} is listed twice; {PAPER!r} is always there")
        return cls(tuple(built))

    def columns(self, kinds: Sequence[str]) -> dict[str, ScoreColumn]:
        """Columns of rows, counts and those of ``paper`` included; scenarios have objects of some kinds."""
        found = {column.name: column for column in COUNTS}
        return found | {
            name: column for own in self._columns_by_metric(kinds) for name, column in own.items()
        }

    def score(self, pair: CloudPair) -> dict[str, float]:
        """Score a pair by all of them: counts, and columns of rows."""
        kinds = () if pair.scenario is None else object_kinds(pair.scenario)
        scores: dict[str, float] = dict(_counts(pair))
        for metric, named in zip(self._all(), self._columns_by_metric(kinds), strict=True):
            scores |= dict(zip(named, metric_scores(metric, pair).values(), strict=True))
        return scores

    def described(self) -> dict[str, dict[str, Any]]:
        """``version`` and ``params`` by name, in terms of JSON."""
        return {
            one.name: {"version": getattr(one, "version", 1), "params": json.loads(canonical_params(one))}
            for one in self._all()
        }

    def _all(self) -> tuple[Metric, ...]:
        return Paper(), *self.further

    def _columns_by_metric(self, kinds: Sequence[str]) -> list[Mapping[str, ScoreColumn]]:
        """Columns of each metric by their names in rows."""
        taken = {column.name for column in COUNTS}
        found: list[Mapping[str, ScoreColumn]] = []
        for metric in self._all():
            own = expanded(metric.columns, kinds)
            found.append({f"{metric.name}_{name}" if name in taken else name: own[name] for name in own})
            taken |= found[-1].keys()
        return found


PAPER_ALONE = Metrics()


def _as_cloud(values: Any, name: str) -> PointCloud:
    """Take a cloud as it is, anything else as an array or table of x, y, z, v and perhaps power."""
    if isinstance(values, PointCloud):
        return values
    try:
        return PointCloud.from_array(values)
    except ValueError as error:
        raise InputError(f"{name}: {error}") from error
