"""The plan of a run, and the job: everything that another process needs to work on it, by content.

A cell's position in the table follows from its key alone, so that rows that come from a
file, from another process or in another order find their place.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from isacbench.bench.cells.provenance import Environment, environment_of
from isacbench.bench.cells.rows import CLOUD_KEYS, DRAW_COLUMNS
from isacbench.bench.cells.task import Entry, Task, build_plugins
from isacbench.bench.suites.suite import Suite
from isacbench.bench.suites.suite_kinds import kind_of
from isacbench.charts import Variant
from isacbench.checked_arrays import Mask
from isacbench.errors import InputError
from isacbench.model.scene import Scenario
from isacbench.model.scenes.scenario import load_scenario
from isacbench.model.scenes.scene_families import scenario_variants
from isacbench.plugins.code_digests import foreign_classes
from isacbench.plugins.discovery import PluginFile, PluginKind, local_plugins, register_plugin


class Block(NamedTuple):
    """Cells that share an observation, by their task's name, trial, SNR, and keys of the entries."""

    scenario: str
    trial: int
    snr_db: float
    entries: tuple[Variant, ...]


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
    """Every cell of a run: task by task, trial by trial, SNR by SNR, entry by entry."""

    tasks: Sequence[Task]
    n_trials: int

    @property
    def n_cells(self) -> int:
        """Cells of all tasks."""
        return len(self._cells)

    @property
    def entries(self) -> list[Entry[Any]]:
        """Entries of all tasks, once each."""
        return list({one.key: one for task in self.tasks for one in task.entries}.values())

    @cached_property
    def environments(self) -> dict[Variant, Environment]:
        """Environments of rows that this process makes, by the key of the entry."""
        return {one.key: environment_of(one.plugin) for one in self.entries}

    def versions(self) -> dict[Variant, Any]:
        """Versions of rows that this process makes, by the key of the entry."""
        return {key: environment["versions"] for key, environment in self.environments.items()}

    @cached_property
    def by_name(self) -> dict[str, Task]:
        """Tasks by name."""
        return {task.name: task for task in self.tasks}

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

    def blocks(self, todo: Mask | None = None) -> list[Block]:
        """List the blocks of the cells that are marked, or of all cells, in the order of the table."""
        if todo is None:
            todo = np.ones(self.n_cells, dtype=np.bool_)
        blocks, start = [], 0
        for task in self.tasks:
            keys = [one.key for one in task.entries]
            shape = self.n_trials, len(task.snr_db), len(keys)
            marked = todo[start : start + math.prod(shape)].reshape(shape)
            start += marked.size
            for trial, at_snr in zip(*np.nonzero(marked.any(axis=2)), strict=True):
                entries = tuple(keys[index] for index in np.flatnonzero(marked[trial, at_snr]))
                blocks.append(Block(task.name, int(trial), task.snr_db[at_snr], entries))
        return blocks

    def shard(self, shard: Shard) -> Mask:
        """Mark the cells of a part of the run: whole trials of a scene, if there are enough.

        Returns
        -------
        ndarray of bool, shape (n_cells,)
        """
        every = pieces(self.blocks(), shard.n)
        part = [number for number, piece in enumerate(every) for block in piece for _ in block.entries]
        return np.array(part) % shard.n == shard.k - 1

    @cached_property
    def _cells(self) -> pd.MultiIndex:
        """Keys of all cells in the order of the table."""
        keys = [
            (task.name, *one.key, snr_db, trial)
            for task in self.tasks
            for trial in range(self.n_trials)
            for snr_db in task.snr_db
            for one in task.entries
        ]
        return pd.MultiIndex.from_tuples(keys, names=CLOUD_KEYS)


def pieces(blocks: Iterable[Block], n: int) -> list[tuple[Block, ...]]:
    """Pieces to hand out: blocks of a trial, which share its echo, or single blocks if trials are too few."""
    trials = [tuple(group) for _, group in groupby(blocks, key=lambda block: block[:2])]
    return trials if len(trials) >= n else [(block,) for trial in trials for block in trial]


@dataclass(frozen=True)
class Job:
    """A suite with its scenarios by name and the plugins that come from files: what other processes need."""

    suite: Suite
    scenarios: Mapping[str, Scenario]
    plugins: tuple[PluginFile, ...] = ()

    @cached_property
    def plan(self) -> Plan:
        """Tasks that the suite's kind makes of the scenarios, and their cells.

        Raises
        ------
        InputError
            If the suite cannot be run on them, or names an unknown plugin.
        """
        for plugin in self.plugins:
            register_plugin(plugin)
        tasks = kind_of(self.suite).tasks(self.suite, self.scenarios)
        for name, n in Counter(task.name for task in tasks).items():
            if n > 1:
                raise InputError(f"scenarios: two scenes have the name {name!r}; rename a scenario")
        return Plan(tasks, self.suite.trials)

    @cached_property
    def parts(self) -> dict[frozenset[Variant], Job]:
        """Jobs for processes of their own, by the keys of the entries that are worked on there.

        Entries with the same classes of somebody else are a part, and so are those of isacbench alone. The
        job of a part imports no code of others, as far as its suite can be stated without them.
        """
        keys: dict[tuple[str, ...], list[Variant]] = {}
        for one in self.plan.entries:
            keys.setdefault(foreign_classes(one.plugin), []).append(one.key)
        return {frozenset(own): self._of_classes({*classes}) for classes, own in keys.items()}

    def _of_classes(self, classes: set[str]) -> Job:
        """Job of the entries with foreign classes of a set alone."""
        changes: dict[str, list[str]] = {}
        kinds: tuple[PluginKind, ...] = "estimator", "detector"
        for kind in kinds:
            built = build_plugins(self.suite, kind, getattr(self.suite, f"{kind}s", ()))
            own = [text for text, plugin in built if classes.issuperset(foreign_classes(plugin))]
            if built:
                changes[f"{kind}s"] = own or [text for text, _ in built]
        metrics = kind_of(self.suite).metrics_of(self.suite).further
        needed = classes.union(*map(foreign_classes, metrics))
        files = [
            one for one in self.plugins if any(name.startswith(f"{one.module_name}.") for name in needed)
        ]
        return Job(self.suite.replace(**changes), self.scenarios, tuple(files))

    def draws(self) -> pd.DataFrame:
        """Scatterers that the tasks drew."""
        tables = [table for task in self.plan.tasks if len(table := task.draws(self.suite.trials))]
        return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame(columns=DRAW_COLUMNS)

    def __getstate__(self) -> dict[str, object]:
        """Leave the plan behind: another process makes its own, with its own plugins."""
        return {key: value for key, value in vars(self).items() if key not in ("plan", "parts")}


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
