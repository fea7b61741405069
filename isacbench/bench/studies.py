"""The studies by the kind of suite that they run."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from isacbench.bench.detection import DetectorStudy
from isacbench.bench.efficiency import Efficiency
from isacbench.bench.imaging import Imaging
from isacbench.bench.link import Link
from isacbench.bench.resolution import Resolution

if TYPE_CHECKING:
    from isacbench.bench.study import Study
    from isacbench.bench.suite import Kind

__all__ = ["STUDIES"]

STUDIES: dict[Kind, Study[Any]] = {
    "imaging": Imaging(),
    "efficiency": Efficiency(),
    "resolution": Resolution(),
    "detection": DetectorStudy(),
    "link": Link(),
}
