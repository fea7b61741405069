"""The scenes of a stored run: the scenario that was observed in each, without the plugins that imaged it."""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import TYPE_CHECKING, cast

import numpy as np

from isacbench.bench.studies.study import ImagedScene
from isacbench.bench.suites.suite_kinds import kind_of
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
"""Keys of a suite that name plugins, which no scene follows from."""


class ObservedScenes:
    """Scenes of a stored run that were imaged, and the scenario of each of their trials.

    Parameters
    ----------
    folder : Path
        Of the run, for messages.
    suite : Suite
    scenarios : mapping of str to Scenario
        By name.
    draws : DataFrame
        Scatterers that trials drew, columns as in `isacbench.bench.cells.record.Results.draws`.
    records : DataFrame
        Rows of the run.

    Attributes
    ----------
    scenes : dict of str to ImagedScene
        By what the column ``scenario`` names. Synthetic maps and users of a link are no imaged scenes.
    """

    def __init__(
        self,
        folder: Path,
        suite: Suite,
        scenarios: Mapping[str, Scenario],
        draws: pd.DataFrame,
        records: pd.DataFrame,
    ) -> None:
        self._folder, self._draws, self._records = folder, draws, records
        bare = {key: () for key in PLUGIN_KEYS if key in type(suite).model_fields}
        scenes = kind_of(suite).scenes(suite.model_copy(update=bare), scenarios)
        self.scenes = {scene.name: scene for scene in scenes if isinstance(scene, ImagedScene)}

    @cached_property
    def _drawn(self) -> dict[tuple[str, int], NDArray[np.intp]]:
        return rows_by_trial(self._draws)

    def scenario(self, name: str, trial: int) -> Scenario:
        """Return the scenario that was observed: as the run keeps what it drew, or else drawn again.

        Raises
        ------
        InputError
            If what was drawn is not kept, and would be drawn otherwise now.
        """
        scene, drawn = self.scenes[name], self._drawn.get((name, trial))
        if not scene.is_drawn:
            return scene.template
        if drawn is None:
            known = self._records.loc[self._records["scenario"] == name, "scenario_content"]
            if (known != scene.content).any():
                raise InputError(
                    f"{self._folder}: what was observed in {name}, trial {trial} is not kept, and would be "
                    "drawn otherwise now; allowed is the isacbench that made the run"
                )
            return scene.drawn(trial)
        points = self._draws.iloc[drawn][POINT_COLUMNS].to_numpy(dtype=np.float64)
        scatterers = Scatterers(
            xyz=points[:, :3],
            velocity=points[:, 3],
            amplitude=np.sqrt(points[:, 4]),
            phase_rad=self._draws["phase_rad"].to_numpy(dtype=np.float64)[drawn],
        )
        with warned_before():
            return dataclasses.replace(scene.template, scatterers=scatterers)


def rows_by_trial(table: pd.DataFrame) -> dict[tuple[str, int], NDArray[np.intp]]:
    """Positions of the rows of a table by scene and trial."""
    groups = table.groupby(["scenario", "trial"], sort=False).indices
    return cast("dict[tuple[str, int], NDArray[np.intp]]", groups)
