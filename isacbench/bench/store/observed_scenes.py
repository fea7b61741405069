"""Scenes of a stored run: the scenario that was observed in each, without the plugins that imaged it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, cast

import numpy as np

from isacbench.bench.studies.study import ImagedScene
from isacbench.bench.studies.study_kinds import STUDIES
from isacbench.errors import InputError
from isacbench.model.cloud_files.point_files import POINT_COLUMNS
from isacbench.model.scene import Scatterers, warned_before

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import pandas as pd
    from numpy.typing import NDArray

    from isacbench.bench.suites.suite import Suite
    from isacbench.model.scene import Scenario

PLUGIN_KEYS = ("estimators", "detectors")
"""Keys of a suite that name plugins, on which no scene depends."""


@dataclass(frozen=True, eq=False)
class ObservedScenes:
    """Scenes of a stored run that were imaged, and the scenario of each of their trials.

    Attributes
    ----------
    folder : Path
        Folder of the run, for messages.
    suite : Suite
    scenarios : mapping of str to Scenario
        By name.
    draws : DataFrame
        Scatterers that trials drew, columns as in `isacbench.bench.cells.record.Results.draws`.
    records : DataFrame
        Rows of the run.
    """

    folder: Path
    suite: Suite
    scenarios: Mapping[str, Scenario]
    draws: pd.DataFrame
    records: pd.DataFrame

    @cached_property
    def scenes(self) -> dict[str, ImagedScene]:
        """Scenes by their value in the column ``scenario``; no synthetic maps and no users of a link."""
        bare = {key: () for key in PLUGIN_KEYS if key in type(self.suite).model_fields}
        scenes = STUDIES[self.suite.kind].scenes(self.suite.model_copy(update=bare), self.scenarios)
        return {scene.name: scene for scene in scenes if isinstance(scene, ImagedScene)}

    @cached_property
    def _drawn(self) -> dict[tuple[str, int], NDArray[np.intp]]:
        return rows_by_trial(self.draws)

    def scenario(self, name: str, trial: int) -> Scenario:
        """Restore the scenario that was observed: from stored draws, or drawn again.

        Parameters
        ----------
        name : str
            Key of `scenes`.
        trial : int

        Returns
        -------
        Scenario

        Raises
        ------
        InputError
            If the draws are not stored, and this isacbench would draw others.
        """
        scene, drawn = self.scenes[name], self._drawn.get((name, trial))
        if not scene.is_drawn:
            return scene.template
        if drawn is None:
            stored = self.records.loc[self.records["scenario"] == name, "scenario_content"]
            if (stored != scene.content).any():
                raise InputError(
                    f"{self.folder}: the scatterers of {name}, trial {trial} are not stored, and this "
                    "isacbench would draw others; allowed is the version of isacbench that made the run"
                )
            return scene.drawn(trial)
        points = self.draws.iloc[drawn][POINT_COLUMNS].to_numpy(dtype=np.float64)
        scatterers = Scatterers(
            xyz=points[:, :3],
            velocity=points[:, 3],
            amplitude=np.sqrt(points[:, 4]),
            phase_rad=self.draws["phase_rad"].to_numpy(dtype=np.float64)[drawn],
        )
        with warned_before():
            return dataclasses.replace(scene.template, scatterers=scatterers)


def rows_by_trial(table: pd.DataFrame) -> dict[tuple[str, int], NDArray[np.intp]]:
    """Group the rows of a table by scene and trial.

    Parameters
    ----------
    table : DataFrame
        With the columns ``scenario`` and ``trial``.

    Returns
    -------
    dict of (str, int) to ndarray of int
        Positions of the rows.
    """
    groups = table.groupby(["scenario", "trial"], sort=False).indices
    return cast("dict[tuple[str, int], NDArray[np.intp]]", groups)
