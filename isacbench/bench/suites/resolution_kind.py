"""The kind ``resolution``: two equal scatterers at ever smaller distances, and whether both are found."""

import math
from typing import Annotated, get_args

from pydantic import Field

from isacbench.bench.suites.kind import SNR_GAIN, Kind, Tables
from isacbench.bench.suites.suite import Listed, Suite
from isacbench.choices import Dimension

Separation = Annotated[float, Field(gt=0, le=10)]
Phase = Annotated[float, Field(gt=-360, lt=360)]


class ResolutionSuite(Suite):
    """Suite of the kind ``resolution``.

    Attributes
    ----------
    dimensions : tuple of {"range", "velocity", "u", "w"}
        Dimensions in which pairs of scatterers differ, one at a time.
    separations_cells : tuple of float
        Distances in Rayleigh cells.
    phases_deg : tuple of float
        Phases between the two echoes at the centre of resource grid and array.
    """

    kind: str = "resolution"
    dimensions: Listed[Dimension] = get_args(Dimension)
    separations_cells: Listed[Separation]
    phases_deg: Listed[Phase] = (0.0,)


RESOLUTION = Kind(
    name="resolution",
    suite=ResolutionSuite,
    columns={
        **SNR_GAIN,
        "template": "",
        "dimension": "",
        "separation_cells": math.nan,
        "phase_deg": math.nan,
        "resolved": False,
        "n_false": 0,
    },
    better={
        "resolved": "higher",
        "snr_gain_db": "neither",
        "separation_cells": "neither",
        "phase_deg": "neither",
    },
    plan="isacbench.bench.studies.resolution_study:resolution_scenes",
    tables=Tables(
        "isacbench.bench.studies.resolution_study:summarise_resolution",
        "isacbench.report.tables.study_tables:resolution_grids",
    ),
    figures="isacbench.report.figures.study_figures:resolution_figures",
)
