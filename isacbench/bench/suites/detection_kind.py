"""The kind ``detection``: detectors on synthetic maps, and in front of estimators on scenarios."""

import math
from typing import Annotated, get_args

from pydantic import AfterValidator, Field

from isacbench.bench.suites.kind import SNR_GAIN, Kind, Tables
from isacbench.bench.suites.suite import Listed, Suite, refuse_repeats
from isacbench.choices import MapName

Pfa = Annotated[float, Field(gt=0, lt=1)]

COUNTS = ["n_targets", "n_hits", "n_clear", "n_false"]
"""Cells with a target, those of them detected, clear cells, and those of them detected."""


class DetectionSuite(Suite):
    """Suite of the kind ``detection``.

    Attributes
    ----------
    detectors : tuple of str
        Detectors as ``name[param=value,...]``: alone on the maps, and in front of
        every estimator on the scenarios.
    maps : tuple of str
        Synthetic maps, see `isacbench.bench.studies.power_maps.draw_power_map`.
    pfa : tuple of float
        Nominal probabilities of false alarm on the maps. Empty: each detector's own.
    """

    kind: str = "detection"
    detectors: Listed[str]
    maps: Annotated[tuple[MapName, ...], AfterValidator(refuse_repeats)] = get_args(MapName)
    pfa: Annotated[tuple[Pfa, ...], AfterValidator(refuse_repeats)] = ()


DETECTION = Kind(
    name="detection",
    suite=DetectionSuite,
    columns={**SNR_GAIN, "detector": "", "pfa": math.nan, **dict.fromkeys(COUNTS, 0)},
    better={
        "n_hits": "higher",
        **dict.fromkeys(["snr_gain_db", "pfa", "n_targets", "n_clear"], "neither"),
    },
    plan="isacbench.bench.studies.detection_study:detection_scenes",
    tables=Tables(
        "isacbench.bench.studies.detection_study:summarise_detection",
        "isacbench.report.tables.study_tables:detection_grids",
    ),
    figures="isacbench.report.figures.study_figures:detection_figures",
)
