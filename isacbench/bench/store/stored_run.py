"""Stored run for Python users: its rows, its clouds by the key of their cell, its scenarios."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import compress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from isacbench.bench.cells.record import CLOUD_KEYS, stored_points
from isacbench.bench.cells.statuses import SCORED
from isacbench.bench.kinds.scenes import ImagedScene
from isacbench.bench.store.run_store import read_manifest, read_scenes, read_sound_rows
from isacbench.bench.suites.suite_kinds import kind_of
from isacbench.display import Description, Displayed, span
from isacbench.errors import InputError, unknown_name
from isacbench.files.escaping import counted, quoted, shortened
from isacbench.model.cloud import PointCloud
from isacbench.model.cloud_files.columns import POINT_COLUMNS
from isacbench.model.scene import Scatterers, warned_before

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from isacbench.bench.store.rows import Rows
    from isacbench.bench.suites.suite import Suite
    from isacbench.model.scene import Scenario

MOST_NAMED = 6
"""Values of a column that a message or a ``repr`` lists."""

MOST_OF_A_PATH = 60
MOST_OF_A_VALUE = 40

NO_IMAGE = (
    "the row is the test of a detector on a map or of a receiver; only rows of estimators have an image"
)

PLUGIN_KEYS = ("estimators", "detectors")
"""Keys of a suite that name plugins, on which no scene depends."""


class CellKey(NamedTuple):
    """Key of a row and of its cloud.

    Attributes
    ----------
    scenario, estimator : str
    params : str
        The estimator's parameters as canonical JSON.
    snr_db : float
    trial : int
    """

    scenario: str
    estimator: str
    params: str
    snr_db: float
    trial: int

    def __str__(self) -> str:
        return f"{self.estimator} on {self.scenario} at {self.snr_db:g} dB, trial {self.trial}"


Row = pd.Series | pd.DataFrame | Mapping[str, Any] | tuple[Any, ...]
"""A row of `StoredRun.rows` in any form that pandas gives, or a `CellKey`."""


@dataclass(frozen=True, eq=False, repr=False)
class StoredRun(Displayed):
    """Run in its folder, as `load_run` reads it. Clouds are read at first use.

    Attributes
    ----------
    folder : Path
    rows : DataFrame
        One row a cell, all columns.
    manifest : mapping of str to Any
        Content of ``manifest.json``: suite, seed, versions, machine.
    """

    folder: Path
    rows: pd.DataFrame
    manifest: Mapping[str, Any]

    @cached_property
    def clouds(self) -> Mapping[CellKey, PointCloud]:
        """Clouds of all cells that were imaged, by `CellKey` or an equal tuple, in the order of the rows."""
        return _Clouds(read_sound_rows(self.folder, self.manifest))

    def cloud(
        self,
        row: Row | None = None,
        /,
        *,
        scenario: str | None = None,
        estimator: str | None = None,
        params: str | None = None,
        snr_db: float | None = None,
        trial: int | None = None,
    ) -> PointCloud:
        """Return the cloud that was estimated in one cell.

        Parameters
        ----------
        row : Series, named tuple, mapping, DataFrame of one row, or CellKey, optional
            Row of `rows`, as ``loc``, ``iterrows`` and ``itertuples`` return it.
        scenario, estimator, params, snr_db, trial : optional
            Key, instead of a row. A part of it is enough if only one row has
            these values.

        Returns
        -------
        PointCloud
            Empty if nothing was detected.

        Raises
        ------
        InputError
            If no row or several rows match, or if the cell has no cloud: it
            failed, or its row is the test of a detector or of a receiver.
        """
        columns = (scenario, estimator, params, snr_db, trial)
        given = {name: value for name, value in zip(CLOUD_KEYS, columns, strict=True) if value is not None}
        wanted = given if row is None else {**_key_columns(row), **given}
        if len(wanted) == len(CLOUD_KEYS) and (cloud := self.clouds.get(CellKey(**wanted))) is not None:
            return cloud
        record = self.rows.iloc[self._position(wanted)]
        key = CellKey(*record[CLOUD_KEYS])
        if key not in self.clouds:
            raise InputError(f"{self.folder}: {key} has no cloud: {_reason(record)}")
        return self.clouds[key]

    def scenario(self, row: Row | str) -> Scenario:
        """Return the scenario that was observed in a row, with its true scatterers.

        Parameters
        ----------
        row : row of `rows` as `cloud` takes it, or str
            If trials draw scatterers, a row has those of its trial. A text is
            the name of a scenario of the suite.

        Returns
        -------
        Scenario
            The cloud of the row was scored against its `truth`, in its `region`.

        Raises
        ------
        InputError
            If the name is unknown, or the row is the test of a detector or of
            a receiver, for which no scenario is observed.
        """
        if isinstance(row, str):
            _, scenarios, _ = self._scenes_read
            if row not in scenarios:
                raise InputError(f"{self.folder}: {unknown_name('scenario', row, scenarios)}")
            return scenarios[row]
        record = self.rows.iloc[self._position(_key_columns(row))]
        key = CellKey(*record[CLOUD_KEYS])
        if key.scenario not in self._observed.scenes:
            raise InputError(f"{self.folder}: {key} has no scenario: {NO_IMAGE}")
        return self._observed.scenario(key.scenario, key.trial)

    def truth(self, row: Row | str) -> PointCloud:
        """Return the true scatterers of `scenario` as a cloud.

        Parameters
        ----------
        row : row of `rows` as `cloud` takes it, or str
            As in `scenario`.

        Returns
        -------
        PointCloud
        """
        return self.scenario(row).truth

    @cached_property
    def _scenes_read(self) -> tuple[Suite, dict[str, Scenario], pd.DataFrame]:
        return read_scenes(self.folder, self.manifest)

    @cached_property
    def _observed(self) -> ObservedScenes:
        return ObservedScenes(self.folder, *self._scenes_read, self.rows)

    def _position(self, wanted: Mapping[str, Any]) -> int:
        """Position in the table of the one row that has some values in its key."""
        is_equal = self.rows[list(wanted)] == list(wanted.values())
        found = np.flatnonzero(is_equal.all(axis=1))
        if found.size != 1:
            given = " and ".join(f"{name} = {quoted(value)}" for name, value in wanted.items()) or "any key"
            rows = self.rows.iloc[found] if found.size else self.rows
            values = "; ".join(f"{name} {_listed(rows[name].unique())}" for name in CLOUD_KEYS)
            whose = "these rows" if found.size else "the rows of the run"
            raise InputError(
                f"{self.folder}: {found.size} rows have {given}; give a key that only one row has. "
                f"The values of {whose} are {values}"
            )
        return int(found[0])

    def _description(self) -> Description:
        rows, suite = self.rows, self.manifest["suite"]
        folder = shortened(str(self.folder), MOST_OF_A_PATH)
        names = rows["estimator"].unique()
        n_variants = len(rows[["estimator", "params"]].drop_duplicates())
        statuses = rows.groupby("status", sort=False).size()
        return Description(
            f"StoredRun of {quoted(suite.get('name'))}: {counted(len(rows), 'row')} in {quoted(folder)}",
            {
                "status": ", ".join(f"{number} {status}" for status, number in statuses.items()),
                "scenarios": _listed(rows["scenario"].unique()),
                "estimators": _listed(names)
                + (f" in {n_variants} variants" if n_variants > len(names) else ""),
                "SNR": span(rows["snr_db"], "dB"),
                "trials": str(rows["trial"].nunique()),
                "started": str(self.manifest.get("started")),
            },
        )


def load_run(folder: str | Path) -> StoredRun:
    """Read a run from its folder, also one that was killed.

    Parameters
    ----------
    folder : str or Path
        Folder that `isacbench run`, or `isacbench.run` with `out`, wrote.

    Returns
    -------
    StoredRun

    Raises
    ------
    InputError
        If the folder does not hold a run, or a damaged one.

    Warns
    -----
    InputWarning
        If lines of the journal of a run that was killed are damaged.

    Examples
    --------
    >>> import tempfile
    >>> from isacbench import run, score
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     records = run("quick", estimators=["fft4d"], snr_db=[10], trials=1, out=folder)
    ...     stored = load_run(folder)
    ...     row = stored.rows.iloc[0]
    ...     scenario, cloud = stored.scenario(row), stored.cloud(row)
    >>> scores = score(scenario.truth, cloud, region=scenario.region)
    >>> bool(scores["deviation"] == row["deviation"])
    True
    """
    folder = Path(folder)
    manifest = read_manifest(folder)
    return StoredRun(folder, read_sound_rows(folder, manifest, with_clouds=False).records, manifest)


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
        scenes = kind_of(self.suite).scenes(self.suite.model_copy(update=bare), self.scenarios)
        return {scene.name: scene for scene in scenes if isinstance(scene, ImagedScene)}

    @cached_property
    def _drawn(self) -> dict[Any, NDArray[np.intp]]:
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
                    "isacbench would draw others; use the version of isacbench that made the run"
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
            return replace(scene.template, scatterers=scatterers)


def rows_by_trial(table: pd.DataFrame) -> dict[Any, NDArray[np.intp]]:
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
    return {key: np.asarray(rows) for key, rows in groups.items()}


class _Clouds(Mapping[CellKey, PointCloud]):
    """Clouds of rows, each built when it is asked for."""

    def __init__(self, rows: Rows) -> None:
        records, ends = rows.records, np.cumsum(rows.n_points)
        is_scored = records["deviation"].notna() & (rows.n_points == stored_points(records))
        keys = records.loc[is_scored, CLOUD_KEYS].itertuples(index=False)
        bounds = zip(ends - rows.n_points, ends, strict=True)
        self._bounds = dict(zip(map(CellKey._make, keys), compress(bounds, is_scored), strict=True))
        self._points = rows.points

    def __getitem__(self, key: CellKey) -> PointCloud:
        return PointCloud.from_array(self._points[slice(*self._bounds[key])])

    def __iter__(self) -> Iterator[CellKey]:
        return iter(self._bounds)

    def __len__(self) -> int:
        return len(self._bounds)

    def __repr__(self) -> str:
        return f"Clouds of {counted(len(self), 'cell')}, by scenario, estimator, params, snr_db and trial"


def _reason(record: pd.Series[Any]) -> str:
    """Reason for which a row has no cloud."""
    if record["status"] not in SCORED:
        return f"its status is {record['status']}, {record['reason']}; allowed are {' and '.join(SCORED)}"
    if pd.isna(record["deviation"]):
        return NO_IMAGE
    return "it is missing or damaged; `isacbench run` into the folder makes it again"


def _key_columns(row: Row) -> dict[str, Any]:
    """Key of a row in any of its forms."""
    if isinstance(row, pd.DataFrame) and len(row) == 1:
        row = row.iloc[0]
    if isinstance(row, tuple):
        row = getattr(row, "_asdict", lambda: dict(zip(CLOUD_KEYS, row, strict=False)))()
    if not isinstance(row, (pd.Series, Mapping)) or any(name not in row for name in CLOUD_KEYS):
        raise InputError(
            f"expected one row of the run's table, or a tuple or mapping of {', '.join(CLOUD_KEYS)}; "
            f"got a {type(row).__name__}"
        )
    return {name: row[name] for name in CLOUD_KEYS}


def _listed(values: Any) -> str:
    """List values, the first ones of many."""
    shown = [shortened(str(value), MOST_OF_A_VALUE) for value in values]
    more = f" and {len(shown) - MOST_NAMED} more" if len(shown) > MOST_NAMED else ""
    return ", ".join(shown[:MOST_NAMED]) + more
