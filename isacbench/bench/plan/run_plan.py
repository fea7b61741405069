"""The plan of a run, and the job: everything that another process needs to work on it, by content.

A cell's position in the table follows from its key alone, so that rows that come from a
file, from another process or in another order find their place.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby, pairwise
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from isacbench.bench.cells.record import CLOUD_KEYS, DRAW_COLUMNS
from isacbench.bench.kinds.scenes import Entry, Scene
from isacbench.bench.store.provenance import environment_of
from isacbench.bench.suites.suite import Suite
from isacbench.bench.suites.suite_kinds import kind_of
from isacbench.errors import InputError
from isacbench.model.scene import Scenario
from isacbench.model.scenes.scenario import load_scenario
from isacbench.model.scenes.scene_families import scenario_variants
from isacbench.plugins.code_digests import foreign_classes
from isacbench.plugins.discovery import PluginFile, PluginKind, local_plugins, register_plugin
from isacbench.plugins.registry import build_variants


class Block(NamedTuple):
    """Cells that share an observation.

    Attributes
    ----------
    scene : int
        Index of the scene.
    entries : tuple of int
        Indices into the scene's entries, those that have not met it yet.
    """

    scene: int
    trial: int
    snr_db: float
    entries: tuple[int, ...]


class Shard(NamedTuple):
    """Part `k` of `n` of a run, counted from 1."""

    k: int
    n: int

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Parse ``k/n``.

        Raises
        ------
        InputError
            Quoting the text and saying what is allowed.

        Examples
        --------
        >>> Shard.parse("2/3")
        Shard(k=2, n=3)
        """
        k, _, n = text.partition("/")
        if not (text.isascii() and k.isdecimal() and n.isdecimal() and 1 <= int(k) <= int(n)):
            raise InputError(f"shard {text!r}: allowed is k/n with 1 <= k <= n, such as 2/3")
        return cls(int(k), int(n))


@dataclass(frozen=True, eq=False)
class Plan:
    """Every cell of a run: scene by scene, trial by trial, SNR by SNR, entry by entry."""

    scenes: Sequence[Scene]
    n_trials: int

    @property
    def n_cells(self) -> int:
        """Cells of all scenes."""
        return len(self._cells)

    @property
    def entries(self) -> list[Entry[Any]]:
        """Entries of all scenes, once each."""
        every = {(one.name, one.params): one for scene in self.scenes for one in scene.entries}
        return list(every.values())

    def versions(self) -> dict[tuple[str, str], Any]:
        """Versions that rows made by this process would have, by name and parameters of the entry."""
        return {(one.name, one.params): environment_of(one.plugin)["versions"] for one in self.entries}

    def positions(self, keys: pd.DataFrame) -> NDArray[np.int64]:
        """Positions in the table of some cells.

        Parameters
        ----------
        keys : DataFrame
            With the columns scenario, estimator, params, snr_db and trial.

        Returns
        -------
        ndarray of int64, shape (n,)
            -1 where the plan has no such cell.
        """
        return self._cells.get_indexer(pd.MultiIndex.from_frame(keys[CLOUD_KEYS]))

    def blocks(self, todo: NDArray[np.bool_]) -> list[Block]:
        """List the blocks of the cells that are marked.

        Parameters
        ----------
        todo : ndarray of bool, shape (n_cells,)

        Returns
        -------
        list of Block
            In the order of the table.
        """
        blocks, start = [], 0
        for index, scene in enumerate(self.scenes):
            shape = self.n_trials, len(scene.snr_db), len(scene.entries)
            marked = todo[start : start + math.prod(shape)].reshape(shape)
            start += marked.size
            for trial, at_snr in zip(*np.nonzero(marked.any(axis=2)), strict=True):
                entries = tuple(np.flatnonzero(marked[trial, at_snr]).tolist())
                blocks.append(Block(index, int(trial), scene.snr_db[at_snr], entries))
        return blocks

    def shard(self, shard: Shard) -> NDArray[np.bool_]:
        """Mark the cells of a part of the run: whole trials of a scene, if there are enough.

        Returns
        -------
        ndarray of bool, shape (n_cells,)
        """
        blocks = self.blocks(np.ones(self.n_cells, dtype=np.bool_))
        trials = [block[:2] for block in blocks]
        part = np.cumsum([before != after for before, after in pairwise([trials[0], *trials])])
        if part[-1] + 1 < shard.n:
            part = np.arange(len(blocks))
        return np.repeat(part % shard.n == shard.k - 1, [len(block.entries) for block in blocks])

    @cached_property
    def _cells(self) -> pd.MultiIndex:
        """Keys of all cells in the order of the table."""
        keys = [
            (scene.name, one.name, one.params, snr_db, trial)
            for scene in self.scenes
            for trial in range(self.n_trials)
            for snr_db in scene.snr_db
            for one in scene.entries
        ]
        return pd.MultiIndex.from_tuples(keys, names=CLOUD_KEYS)


class BlockQueue:
    """Blocks for several workers: each goes on with its own trial of a scene, whose echo it keeps."""

    def __init__(self, blocks: Sequence[Block]) -> None:
        self._lock = Lock()
        self._waiting = deque(deque(group) for _, group in groupby(blocks, key=lambda block: block[:2]))
        self._taken: list[deque[Block]] = []

    def blocks(self) -> Iterator[Block]:
        """Blocks for one worker, until no block is left."""
        mine: deque[Block] = deque()
        while True:
            with self._lock:
                if not mine and self._waiting:
                    mine = self._waiting.popleft()
                    self._taken.append(mine)
                # If no trial is untouched: the last block of the longest queue.
                fullest = max(self._taken, key=len, default=mine)
                if not fullest:
                    return
                block = mine.popleft() if mine else fullest.pop()
            yield block


class EntryKey(NamedTuple):
    """Key of an entry of a scene.

    Attributes
    ----------
    owner : tuple of str
        Its classes that are not of isacbench: they have a process of their own.
    """

    name: str
    params: str
    owner: tuple[str, ...]


@dataclass(frozen=True)
class Job:
    """A suite with its scenarios and the plugins that come from files.

    Attributes
    ----------
    scenarios : mapping of str to Scenario
        By name.
    """

    suite: Suite
    scenarios: Mapping[str, Scenario]
    plugins: tuple[PluginFile, ...] = ()

    @cached_property
    def plan(self) -> Plan:
        """Scenes that the suite's study makes of the scenarios, and their cells.

        Raises
        ------
        InputError
            If the suite cannot be run on them, or names an unknown plugin.
        """
        for plugin in self.plugins:
            register_plugin(plugin)
        scenes = kind_of(self.suite).scenes(self.suite, self.scenarios)
        for name, n in Counter(scene.name for scene in scenes).items():
            if n > 1:
                raise InputError(f"scenarios: two scenes have the name {name!r}; rename a scenario")
        return Plan(scenes, self.suite.trials)

    @cached_property
    def keys(self) -> list[list[EntryKey]]:
        """Keys of the entries of each scene, which another process knows without making the plan."""
        return [
            [EntryKey(one.name, one.params, foreign_classes(one.plugin)) for one in scene.entries]
            for scene in self.plan.scenes
        ]

    @cached_property
    def parts(self) -> dict[tuple[str, ...], Job]:
        """Jobs by the owner of entries: each has at least these, and imports no code of others for them."""
        owners = dict.fromkeys(key.owner for keys in self.keys for key in keys)
        return {owner: self._of_owner(owner) for owner in owners}

    def _of_owner(self, owner: tuple[str, ...]) -> Job:
        kinds: tuple[tuple[str, PluginKind], ...] = ("estimators", "estimator"), ("detectors", "detector")
        changes = {key: self._texts_of(owner, key, kind) for key, kind in kinds if hasattr(self.suite, key)}
        metrics = kind_of(self.suite).metrics_of(self.suite).further
        needed = {*owner}.union(*map(foreign_classes, metrics))
        files = [
            one for one in self.plugins if any(name.startswith(f"{one.module_name}.") for name in needed)
        ]
        part = Job(self.suite.replace(**changes), self.scenarios, tuple(files))
        vars(part)["keys"] = self.keys
        return part

    def _texts_of(self, owner: tuple[str, ...], key: str, kind: PluginKind) -> list[str]:
        """Spell the plugins of the suite that have no classes but the owner's; all if there are none."""
        built: list[tuple[str, Any]] = []
        for text in getattr(self.suite, key):
            own = self.suite.instances.get(text)
            built += build_variants(kind, text) if own is None else [(text, own)]
        return [text for text, plugin in built if {*owner} >= {*foreign_classes(plugin)}] or [
            text for text, _ in built
        ]

    def draws(self) -> pd.DataFrame:
        """Scatterers that the scenes drew."""
        tables = [table for scene in self.plan.scenes if len(table := scene.draws(self.suite.trials))]
        return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame(columns=DRAW_COLUMNS)

    def __getstate__(self) -> dict[str, object]:
        """Leave the plan behind: another process makes its own, with its own plugins."""
        return {key: value for key, value in vars(self).items() if key != "plan"}


def load_job(suite: Suite) -> Job:
    """Load the scenarios of a suite, and take the plugins from files that are registered.

    Raises
    ------
    InputError
        If a scenario is unknown, wrong, or one of two with the same name.
    """
    loaded: dict[str, Scenario] = {}
    for name_or_path in (name for listed in suite.scenarios for name in scenario_variants(listed)):
        scenario = load_scenario(name_or_path)
        if scenario.name in loaded:
            raise InputError(f"scenarios: {name_or_path!r} repeats the name {scenario.name!r}")
        loaded[scenario.name] = scenario
    return Job(suite, loaded, local_plugins())
