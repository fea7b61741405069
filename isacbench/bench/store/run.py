"""A run: its rows, its clouds by the key of their cell, its scenarios, and the manifest that describes it."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from isacbench.bench.cells.provenance import Environment
from isacbench.bench.cells.rows import (
    CLOUD_KEYS,
    COLUMNS,
    DRAW_COLUMNS,
    SCORED,
    require_sound_records,
    stored_points,
    typed,
)
from isacbench.bench.cells.task import ImagingTask
from isacbench.bench.store import run_folder as files
from isacbench.bench.store.manifest import SCORES, read_manifest, row_columns, stored_columns, write_manifest
from isacbench.bench.store.run_folder import DAMAGE, atomic_write, damage_named, damage_text
from isacbench.bench.suites.scenario_digest import restore_scatterers, restore_scenario, truth_table
from isacbench.bench.suites.suite import Suite
from isacbench.bench.suites.suite_kinds import kind_of, restore_suite
from isacbench.checked_arrays import Mask
from isacbench.display import Description, Displayed, range_text
from isacbench.errors import AccessError, InputError, InputWarning, unknown_name
from isacbench.files.checked_files import path_exists
from isacbench.files.escaping import plural, quoted, shortened
from isacbench.model.cloud import PointCloud
from isacbench.model.scene import Scenario, no_input_warnings

T = TypeVar("T")

MOST_NAMED = 6
"""Values of a column that a message or a ``repr`` lists."""

LONGEST_PATH = 60
LONGEST_VALUE = 40

NO_IMAGE = (
    "the row is the test of a detector on a map or of a receiver; only rows of estimators have an image"
)

PLUGIN_KEYS = ("estimators", "detectors", "metrics")
"""Keys of a suite that name plugins, on which no scene depends."""

COMPARED = ("suite", "seed", SCORES, "scenarios", "environments")
"""Parts of a manifest without which a run cannot be compared."""


class CellKey(NamedTuple):
    """Key of a row and of its cloud.

    Attributes
    ----------
    params : str
        The estimator's parameters as canonical JSON.
    """

    scenario: str
    estimator: str
    params: str
    snr_db: float
    trial: int

    def __str__(self) -> str:
        return f"{self.estimator} on {self.scenario} at {self.snr_db:g} dB, trial {self.trial}"


Row = pd.Series | pd.DataFrame | Mapping[str, Any] | tuple[Any, ...]
"""A row of `Run.rows` in any form that pandas gives, or a `CellKey`."""


class Scenes(NamedTuple):
    """Suite of a run, its scenarios by name, and the scatterers that its trials drew, a row each."""

    suite: Suite
    scenarios: Mapping[str, Scenario]
    draws: pd.DataFrame


@dataclass(frozen=True, eq=False, repr=False)
class Run(Displayed):
    """Run in its folder, as `load_run` reads it, or in memory. Clouds and scenarios are read at first use.

    Attributes
    ----------
    label : str
        Name in messages: its folder.
    rows : DataFrame
        One row a cell, all columns.
    manifest : mapping of str to Any
        Content of ``manifest.json``: suite, seed, versions, machine.
    has_scenarios : bool
        False of a run that was published as rows alone.
    read_clouds, read_scenes : callable
        Called at most once.
    """

    label: str
    rows: pd.DataFrame
    manifest: Mapping[str, Any]
    has_scenarios: bool = True
    read_clouds: Callable[[], files.Clouds] | None = None
    read_scenes: Callable[[], Scenes] | None = None

    @classmethod
    def open(cls, folder: Path) -> Run:
        """Read a run, also one that was killed. InputError if there is none, or it is damaged.

        Damaged lines of a journal are left out with a warning.
        """
        manifest = read_manifest(folder)
        if not path_exists(folder / files.RECORDS) and not path_exists(folder / files.JOURNAL):
            raise InputError(
                f"{folder}: has no rows, {files.RECORDS} is missing; isacbench run into it makes them"
            )
        with damage_named(folder):
            run = _read_run(folder, manifest, _read_if_there)
            run = run.take(~run.rows.duplicated(CLOUD_KEYS, keep="last").to_numpy())
            columns = row_columns(restore_suite(manifest["suite"]), stored_columns(manifest))
            rows = typed(run.rows, columns)
            require_sound_records(rows)
            _require_described_scenarios(rows, manifest)
        return run.changed(rows=rows)

    @classmethod
    def recover(cls, folder: Path) -> Run:
        """Read what is left of a run that is to go on; what is damaged or missing is left out with a warning.

        If a cell has several rows, the last one counts.
        """
        manifest = _read_undamaged(lambda _: read_manifest(folder), folder / files.MANIFEST)
        return _read_run(folder, manifest or {}, _read_undamaged)

    @classmethod
    def of_journal(cls, path: Path) -> Run:
        """Read the rows of a journal; damaged lines are left out with a warning."""
        rows, clouds, environments, n_torn = files.read_journal(path)
        if n_torn:
            _warn_of_damage(path, f"{n_torn} lines")
        return cls(str(path.parent), rows, {"environments": environments}, read_clouds=lambda: clouds)

    @classmethod
    def joined(cls, parts: Sequence[Run]) -> Run:
        """Rows of several runs, one after the other, with their clouds and environments."""
        found = [part.rows for part in parts if len(part.rows)]
        return cls(
            " and ".join(part.label for part in parts),
            pd.concat(found, ignore_index=True) if found else pd.DataFrame(columns=COLUMNS),
            {"environments": {name: one for part in parts for name, one in part.environments.items()}},
            read_clouds=lambda: [one for part in parts for one in part.points],
        )

    @property
    def folder(self) -> Path:
        """Folder in which it is stored."""
        return Path(self.label)

    @property
    def kind(self) -> str:
        """Kind of its suite."""
        return str(self.manifest["suite"].get("kind", "imaging"))

    @property
    def environments(self) -> Mapping[str, Environment]:
        """Environments by the names that the rows have."""
        found: Mapping[str, Environment] = self.manifest.get("environments", {})
        return found

    @cached_property
    def points(self) -> files.Clouds:
        """Clouds in the order of the rows, empty where there is none."""
        return [files.NO_POINTS] * len(self.rows) if self.read_clouds is None else self.read_clouds()

    @cached_property
    def scenes(self) -> Scenes:
        """Suite, scenarios and draws, read together."""
        return _read_scenes(self.folder, self.manifest) if self.read_scenes is None else self.read_scenes()

    @cached_property
    def suite(self) -> Suite:
        """The suite as it was run, overrides included."""
        with damage_named(self.folder):
            return restore_suite(self.manifest["suite"])

    @property
    def scenarios(self) -> Mapping[str, Scenario]:
        """Scenarios by name, as the suite lists them."""
        return self.scenes.scenarios

    @property
    def draws(self) -> pd.DataFrame:
        """One row for each scatterer that a trial drew: scenario, trial, x, y, z, v, power, phase_rad."""
        return self.scenes.draws

    @cached_property
    def imaged_scenes(self) -> Mapping[str, ImagingTask]:
        """Scenes that were imaged, by name; no synthetic maps and no users of a link."""
        suite = self.scenes.suite
        bare = {key: () for key in PLUGIN_KEYS if key in type(suite).model_fields}
        scenes = kind_of(suite).tasks(suite.model_copy(update=bare), self.scenarios)
        return {scene.name: scene for scene in scenes if isinstance(scene, ImagingTask)}

    def changed(self, **changes: Any) -> Run:
        """Replace attributes: rows by others of the same cells, the label, the manifest."""
        known = {"read_clouds": lambda: self.points, "read_scenes": lambda: self.scenes}
        return replace(self, **known | changes)

    def take(self, picked: NDArray[np.int64] | NDArray[np.bool_]) -> Run:
        """Select rows by a mask, or by their positions in the wanted order."""
        places: NDArray[Any] = np.flatnonzero(picked) if picked.dtype == np.bool_ else picked
        rows = self.rows.iloc[places].reset_index(drop=True)
        return self.changed(rows=rows, read_clouds=lambda: [self.points[place] for place in places])

    def require_finished(self) -> Run:
        """Return the run, or refuse one that was killed, or of which it is not known what it measured."""
        if path_exists(self.folder / files.JOURNAL):
            raise InputError(
                f"{self.label}: the run is not finished; resume it with the same isacbench run command"
            )
        self.require_described(COMPARED)
        return self

    def require_described(self, keys: Iterable[str]) -> None:
        """Refuse a run whose manifest lacks some keys, or environments of its rows."""
        made_by = self.rows["environment"].unique()
        for wanted, present in ((keys, self.manifest), (made_by, self.environments)):
            if missing := [str(name) for name in wanted if name not in present]:
                raise InputError(
                    f"{self.folder / files.MANIFEST}: {', '.join(missing)} missing; run it again with this "
                    "version"
                )

    def is_whole(self) -> Mask:
        """Tell of which rows the cloud has all its points."""
        return np.equal(files.sizes(self.points), stored_points(self.rows))

    def lost_clouds(self) -> Mask:
        """Tell of which images the cloud is missing or damaged."""
        return is_image(self.rows) & ~self.is_whole()

    def require_clouds(self) -> None:
        """Refuse a run that has lost clouds."""
        if n_lost := int(self.lost_clouds().sum()):
            raise InputError(
                f"{self.label}: {n_lost} of {is_image(self.rows).sum()} clouds are missing or damaged; "
                "`isacbench run` into the folder makes them again"
            )

    def save(self, folder: Path) -> None:
        """Write tables and manifest into an existing folder, and then remove the journal."""
        write_truth(folder, self.scenarios)
        if len(self.draws):
            files.write_table(self.draws, folder / files.DRAWS)
        self.save_rows(folder)
        with atomic_write(folder / files.RECORDS_CSV) as path:
            files.write_csv_table(files.without_formulas(self.rows), path)
        write_manifest(folder, self.manifest)
        (folder / files.JOURNAL).unlink(missing_ok=True)

    def save_rows(self, folder: Path) -> None:
        """Write rows and clouds, in place of older ones."""
        files.write_table(files.cloud_table(self.rows, self.points), folder / files.CLOUDS)
        files.write_table(self.rows, folder / files.RECORDS)

    @cached_property
    def clouds(self) -> Mapping[CellKey, PointCloud]:
        """Clouds of all cells that were imaged, by `CellKey` or an equal tuple, in the order of the rows."""
        return _Clouds(self)

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
        key, row_found = self._only_row(wanted)
        if key not in self.clouds:
            raise InputError(f"{self.label}: {key} has no cloud: {_why_no_cloud(row_found)}")
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
            if row not in self.scenarios:
                raise InputError(f"{self.label}: {unknown_name('scenario', row, self.scenarios)}")
            return self.scenarios[row]
        key, _ = self._only_row(_key_columns(row))
        if key.scenario not in self.imaged_scenes:
            raise InputError(f"{self.label}: {key} has no scenario: {NO_IMAGE}")
        return self.observed(key.scenario, key.trial)

    def truth(self, row: Row | str) -> PointCloud:
        """Return the true scatterers of `scenario` as a cloud."""
        return self.scenario(row).truth

    def observed(self, name: str, trial: int) -> Scenario:
        """Restore the scenario that a trial of an imaged scene observed, from stored draws or drawn again."""
        scene, drawn = self.imaged_scenes[name], self._draw_places.get((name, trial))
        if not scene.is_drawn:
            return scene.template
        if drawn is None:
            stored = self.rows.loc[self.rows["scenario"] == name, "scenario_content"]
            if (stored != scene.content).any():
                raise InputError(
                    f"{self.label}: the scatterers of {name}, trial {trial} are not stored, and this "
                    "isacbench would draw others; use the version of isacbench that made the run"
                )
            return scene.scenario_of(trial)
        with no_input_warnings():
            return replace(scene.template, scatterers=restore_scatterers(self.draws.iloc[drawn]))

    @cached_property
    def _draw_places(self) -> Mapping[Any, Any]:
        """Positions of the draws by scene and trial."""
        return self.draws.groupby(["scenario", "trial"]).indices

    def _only_row(self, wanted: Mapping[str, Any]) -> tuple[CellKey, pd.Series[Any]]:
        """Find the one row that has some values in its key."""
        found = self.rows[(self.rows[list(wanted)] == list(wanted.values())).all(axis=1)]
        if len(found) != 1:
            given = " and ".join(f"{name} = {quoted(value)}" for name, value in wanted.items()) or "any key"
            rows, whose = (self.rows, "the rows of the run") if found.empty else (found, "these rows")
            values = "; ".join(f"{name} {_value_list(rows[name].unique())}" for name in CLOUD_KEYS)
            raise InputError(
                f"{self.label}: {len(found)} rows have {given}; give a key that only one row has. "
                f"The values of {whose} are {values}"
            )
        row = found.iloc[0]
        return CellKey(*row[CLOUD_KEYS]), row

    def _description(self) -> Description:
        rows, suite = self.rows, self.manifest["suite"]
        estimators = rows["estimator"].unique()
        n_variants = len(rows[["estimator", "params"]].drop_duplicates())
        statuses = rows.groupby("status", sort=False).size()
        return Description(
            f"Run of {quoted(suite.get('name'))}: {plural(len(rows), 'row')} in "
            f"{quoted(shortened(self.label, LONGEST_PATH))}",
            {
                "status": ", ".join(f"{number} {status}" for status, number in statuses.items()),
                "scenarios": _value_list(rows["scenario"].unique()),
                "estimators": _value_list(estimators)
                + (f" in {n_variants} variants" if n_variants > len(estimators) else ""),
                "SNR": range_text(rows["snr_db"], "dB"),
                "trials": str(rows["trial"].nunique()),
                "started": str(self.manifest.get("started")),
            },
        )


def load_run(folder: str | Path) -> Run:
    """Read a run from its folder, also one that was killed.

    Parameters
    ----------
    folder : str or Path
        Folder that `isacbench run`, or `isacbench.run` with `out`, wrote.

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
    return Run.open(Path(folder))


def write_truth(folder: Path, scenarios: Mapping[str, Scenario]) -> None:
    """Write the scatterers of the scenarios of a run."""
    truth = pd.concat([truth_table(scenario) for scenario in scenarios.values()], ignore_index=True)
    files.write_table(truth, folder / files.TRUTH)


def is_image(rows: pd.DataFrame) -> Mask:
    """Tell which rows are of images: those with a deviation, and of drops also those without targets."""
    found = rows["deviation"].notna()
    if "n_detections" in rows:
        found |= rows["status"].isin(SCORED)
    return found.to_numpy()


class _Clouds(Mapping[CellKey, PointCloud]):
    """Clouds of rows, each built when it is asked for."""

    def __init__(self, run: Run) -> None:
        self._points = run.points
        places = np.flatnonzero(is_image(run.rows) & run.is_whole())
        keys = run.rows[CLOUD_KEYS].iloc[places].itertuples(index=False)
        self._places = dict(zip(map(CellKey._make, keys), places.tolist(), strict=True))

    def __getitem__(self, key: CellKey) -> PointCloud:
        return PointCloud.from_array(self._points[self._places[key]])

    def __iter__(self) -> Iterator[CellKey]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def __repr__(self) -> str:
        return f"Clouds of {plural(len(self), 'cell')}, by scenario, estimator, params, snr_db and trial"


Read = Callable[[Callable[[Path], Any], Path], Any]
"""Way to read a file that may be missing: `_read_if_there` or `_read_undamaged`."""


def _read_run(folder: Path, manifest: Mapping[str, Any], read: Read) -> Run:
    """All rows of a folder as they are, of which the last one of a cell counts."""
    rows, parts = read(_read_rows, folder / files.RECORDS), []
    if rows is not None:
        read_clouds = partial(_read_clouds, folder, rows, read)
        parts.append(Run(str(folder), rows, manifest, read_clouds=read_clouds))
    if path_exists(folder / files.JOURNAL):
        parts.append(Run.of_journal(folder / files.JOURNAL))
    run = Run.joined(parts)
    manifest, has_scenarios = {**manifest, **run.manifest}, path_exists(folder / files.TRUTH)
    return replace(run, label=str(folder), manifest=manifest, has_scenarios=has_scenarios)


def _read_if_there(read: Callable[[Path], T], path: Path) -> T | None:
    return read(path) if path_exists(path) else None


def _read_undamaged(read: Callable[[Path], T], path: Path) -> T | None:
    """Read a file; warn of damage."""
    try:
        return _read_if_there(read, path)
    except AccessError:
        raise
    except DAMAGE as error:
        _warn_of_damage(path, damage_text(error))
        return None


def _read_rows(path: Path) -> pd.DataFrame:
    rows = files.read_table(path)
    if missing := [name for name in COLUMNS if name not in rows]:
        raise ValueError(f"{path.name} has no column {missing[0]}")
    if rows.duplicated(CLOUD_KEYS).any():
        raise ValueError(f"{path.name} has several rows of a cell")
    return rows


def _read_clouds(folder: Path, rows: pd.DataFrame, read: Read) -> files.Clouds:
    with damage_named(folder):
        table = read(files.read_table, folder / files.CLOUDS)
        return [files.NO_POINTS] * len(rows) if table is None else files.clouds_of(rows, table)


def _read_scenes(folder: Path, manifest: Mapping[str, Any]) -> Scenes:
    with damage_named(folder):
        truth = files.read_table(folder / files.TRUTH)
        scenarios = {
            name: restore_scenario(name, described, truth[truth["scenario"] == name])
            for name, described in manifest["scenarios"].items()
        }
        draws = _read_if_there(files.read_table, folder / files.DRAWS)
        if draws is None:
            draws = pd.DataFrame(columns=DRAW_COLUMNS)
        return Scenes(restore_suite(manifest["suite"]), scenarios, draws)


def _require_described_scenarios(rows: pd.DataFrame, manifest: Mapping[str, Any]) -> None:
    """Refuse rows of scenarios that the manifest does not describe."""
    # Studies that derive scenes from a scenario name it in the column template, empty for a link's user.
    scenarios = rows["template" if "template" in rows else "scenario"].dropna().unique()
    described = manifest["scenarios"]
    missing = set(scenarios) - {"", *described, *manifest["suite"].get("maps", ())}
    if missing:
        raise InputError(
            f"its rows name the scenarios {quoted(sorted(missing))}, which its manifest does not describe; "
            f"allowed are {quoted(sorted(described))}"
        )


def _warn_of_damage(path: Path, what: str) -> None:
    warnings.warn(
        f"{path}: damaged, its cells are left out and run again ({what})", InputWarning, stacklevel=2
    )


def _why_no_cloud(row: pd.Series[Any]) -> str:
    if row["status"] not in SCORED:
        return f"its status is {row['status']}, {row['reason']}; allowed are {' and '.join(SCORED)}"
    if not is_image(row.to_frame().T).all():
        return NO_IMAGE
    return "it is missing or damaged; `isacbench run` into the folder makes it again"


def _key_columns(row: Row) -> dict[str, Any]:
    """Key of a row in any of its forms."""
    if isinstance(row, pd.DataFrame) and len(row) == 1:
        row = row.iloc[0]
    if isinstance(row, tuple):
        row = row._asdict() if hasattr(row, "_asdict") else dict(zip(CLOUD_KEYS, row, strict=False))
    if not isinstance(row, (pd.Series, Mapping)) or any(name not in row for name in CLOUD_KEYS):
        raise InputError(
            f"expected one row of the run's table, or a tuple or mapping of {', '.join(CLOUD_KEYS)}; "
            f"got a {type(row).__name__}"
        )
    return {name: row[name] for name in CLOUD_KEYS}


def _value_list(values: Any) -> str:
    """List values, the first ones of many."""
    shown = [shortened(str(value), LONGEST_VALUE) for value in values]
    more = f" and {len(shown) - MOST_NAMED} more" if len(shown) > MOST_NAMED else ""
    return ", ".join(shown[:MOST_NAMED]) + more
