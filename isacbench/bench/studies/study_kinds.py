"""The studies by the kind of suite that they run."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from isacbench.bench.studies.detection_study import DetectorStudy
from isacbench.bench.studies.efficiency_study import Efficiency
from isacbench.bench.studies.imaging_study import ImagingStudy
from isacbench.bench.studies.link_study import Link
from isacbench.bench.studies.resolution_study import Resolution

if TYPE_CHECKING:
    from isacbench.bench.studies.study import Study
    from isacbench.bench.suites.suite import StudyKind

STUDIES: dict[StudyKind, Study[Any]] = {
    "imaging": ImagingStudy(),
    "efficiency": Efficiency(),
    "resolution": Resolution(),
    "detection": DetectorStudy(),
    "link": Link(),
}
