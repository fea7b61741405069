"""The kind ``population``: many scenes of several families, each as it is; the scene is the unit."""

from typing import Annotated

from pydantic import Field

from isacbench.bench.suites.kind import OF_IMAGES, OF_TIMED_IMAGES, Kind, Tables
from isacbench.bench.suites.suite import Suite


class PopulationSuite(Suite):
    """Suite of the kind ``population``.

    Attributes
    ----------
    version : int
        Version of the population, which says which scenes it has. Runs of different versions are not
        merged.
    """

    kind: str = "population"
    version: Annotated[int, Field(ge=1)]


POPULATION = Kind(
    name="population",
    suite=PopulationSuite,
    columns={
        "family": "",
        "frame": "",
        "coherent_phase": False,
        "n_resolvable": 0,
        "n_resolved": 0,
        "n_false": 0,
    },
    better={"n_resolved": "higher", "n_resolvable": "neither", "coherent_phase": "neither"},
    plan="isacbench.bench.studies.population_study:population_scenes",
    tables=Tables(
        "isacbench.report.tables.population_tables:tabulate_population",
        "isacbench.report.tables.population_tables:population_grids",
    ),
    metrics=OF_IMAGES,
    timed_tables=OF_TIMED_IMAGES,
    figures="isacbench.report.figures.population_figures:population_figures",
)
