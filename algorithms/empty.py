"""No point at all: the scores of an image that an estimator does not deliver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from isacbench.model.cloud import PointCloud

from .bases.references import Reference

if TYPE_CHECKING:
    from isacbench.plugins.contracts import Radio


@dataclass(frozen=True)
class Empty(Reference):
    """Zero effort: an image without points."""

    name: ClassVar[str] = "empty"

    def realisations(self, radio: Radio, truth: PointCloud) -> list[PointCloud]:
        """Make an image without points.

        Parameters
        ----------
        radio : Radio
            Scenario or observation.
        truth : PointCloud

        Returns
        -------
        list of PointCloud
            One.
        """
        return [PointCloud.empty()]
