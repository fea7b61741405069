"""The kind ``efficiency``: one scatterer at random places, and errors compared with the Cramér-Rao bound."""

import math

from isacbench.bench.suites.kind import SNR_GAIN, Kind, Tables

ERRORS = ["error_range_m", "error_velocity_mps", "error_u", "error_w"]
"""Errors of a hit, which have a sign."""

BOUNDS = ["bound_range_m", "bound_velocity_mps", "bound_u", "bound_w"]
"""Cramér-Rao bounds, standard deviations."""

EFFICIENCY = Kind(
    name="efficiency",
    columns={**SNR_GAIN, "hit": False, "n_false": 0, **dict.fromkeys([*ERRORS, *BOUNDS], math.nan)},
    better={"hit": "higher", **dict.fromkeys([*SNR_GAIN, *ERRORS, *BOUNDS], "neither")},
    plan="isacbench.bench.studies.efficiency_study:efficiency_scenes",
    tables=Tables(
        "isacbench.bench.studies.efficiency_study:summarise_efficiency",
        "isacbench.report.tables.study_tables:efficiency_grids",
    ),
    figures="isacbench.report.figures.study_figures:efficiency_figures",
)
