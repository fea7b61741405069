"""The metric ``paper``: the paper's imaging deviation, and scores that stand beside it in every row."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from isacbench.metrics.cloud_scores import pair_scores
from isacbench.metrics.descriptions import ScoreColumn
from isacbench.metrics.deviation import pair_deviation

if TYPE_CHECKING:
    from isacbench.metrics.geometry import CloudPair


@dataclass(frozen=True)
class Paper:
    """The paper's imaging deviation, and chamfer, GOSPA, precision and recall."""

    name: ClassVar[str] = "paper"
    version: ClassVar[int] = 1
    columns: ClassVar[tuple[ScoreColumn, ...]] = (
        ScoreColumn("hausdorff_xy_m", "Hausdorff distance of the xy projections", "m"),
        ScoreColumn("hausdorff_xz_m", "Hausdorff distance of the xz projections", "m"),
        ScoreColumn("hausdorff_yz_m", "Hausdorff distance of the yz projections", "m"),
        ScoreColumn("hausdorff_sum_m", "sum of the three Hausdorff distances", "m"),
        ScoreColumn("density", "relative error of the number of points", "", "lower", 1.0),
        ScoreColumn("velocity_nmse", "normalised mean square error of the velocity", "", "lower", 1.0),
        ScoreColumn("deviation", "imaging deviation: sum of the three Hausdorff distances, density and NMSE"),
        ScoreColumn("chamfer_m", "chamfer distance, mean of both directions", "m"),
        ScoreColumn("gospa_m", "GOSPA distance with c = the radius, p = 2, α = 2", "m"),
        ScoreColumn(
            "precision", "share of estimated points within the radius of a scatterer", "", "higher", 0.0
        ),
        ScoreColumn("recall", "share of true scatterers within the radius of a point", "", "higher", 0.0),
    )

    def score(self, pair: CloudPair) -> dict[str, float]:
        """Score a pair.

        Parameters
        ----------
        pair : CloudPair

        Returns
        -------
        dict of str to float
        """
        parts = pair_deviation(pair), pair_scores(pair)
        names = [column.name for column in self.columns]
        return {name: next(getattr(part, name) for part in parts if hasattr(part, name)) for name in names}
