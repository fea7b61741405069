"""The kind ``population``: many scenes of several families, each as it is; the scene is the unit."""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import Field

from isacbench.bench.suites.kind import OF_IMAGES, OF_TIMED_IMAGES, Kind, Tables
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputError
from isacbench.model.scenes.scene_families import use_of_seed


class PopulationSuite(Suite):
    """Suite of the kind ``population``.

    Attributes
    ----------
    version : int
        Version of the population, which says which scenes it has. Runs of different versions are not
        merged.
    block_seeds : int or None
        Seeds of its scenes, which follow each other: another block has the next ones.
    """

    kind: str = "population"
    version: Annotated[int, Field(ge=1)]
    block_seeds: Annotated[int, Field(ge=1)] | None = None

    def in_block(self, number: int) -> PopulationSuite:
        """Shift the seeds of all scenes by a number of blocks.

        Parameters
        ----------
        number : int
            0 for the scenes as they are.

        Returns
        -------
        PopulationSuite

        Raises
        ------
        InputError
            If the suite has no blocks, or seeds would be for something else: below 500 for developing, to 999
            for validating, from 1000 for reporting.
        """
        if self.block_seeds is None:
            raise InputError(f"suite {self.name} has no blocks: it lacks the key block_seeds")
        shift = number * self.block_seeds

        def moved(match: re.Match[str]) -> str:
            seeds = [int(seed) for seed in match[1].split(":")]
            if any(use_of_seed(seed + shift) != use_of_seed(seed) for seed in seeds):
                raise InputError(
                    f"block {number}: {match[0]} of suite {self.name} becomes {seeds[0] + shift}; allowed "
                    f"are blocks whose seeds stay for {use_of_seed(seeds[0])}"
                )
            return "seed=" + ":".join(str(seed + shift) for seed in seeds)

        scenarios = [re.sub(r"seed=(\d+(?::\d+)?)", moved, text) for text in self.scenarios]
        return self.replace(scenarios=scenarios) if shift else self


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
