"""A job: everything that another process needs to work on a run, by content."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import pandas as pd

from isacbench.bench.cells.record import DRAW_COLUMNS
from isacbench.bench.plan.run_plan import Plan
from isacbench.bench.suites.suite_kinds import kind_of
from isacbench.errors import InputError
from isacbench.model.scenes.scenario import load_scenario
from isacbench.model.scenes.scene_families import scenario_variants
from isacbench.plugins.code_digests import foreign_classes
from isacbench.plugins.discovery import local_plugins, register_plugin
from isacbench.plugins.registry import build_variants

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from isacbench.bench.kinds.scenes import Scene
    from isacbench.bench.suites.suite import Suite
    from isacbench.model.scene import Scenario
    from isacbench.plugins.discovery import PluginFile, PluginKind


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
        _refuse_repeats(scenes)
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
        scored_by = [
            name
            for metric in kind_of(self.suite).metrics_of(self.suite).further
            for name in foreign_classes(metric)
        ]
        needed = *owner, *scored_by
        files = [
            one for one in self.plugins if any(name.startswith(f"{one.module_name}.") for name in needed)
        ]
        part = Job(self.suite.replace(**changes), self.scenarios, tuple(files))
        vars(part)["keys"] = self.keys
        return part

    def _texts_of(self, owner: tuple[str, ...], key: str, kind: PluginKind) -> list[str]:
        """Spell the plugins of the suite that have no classes but the owner's; all if there are none."""
        known = self.suite.instances
        built = [
            variant
            for text in getattr(self.suite, key)
            for variant in ([(text, known[text])] if text in known else build_variants(kind, text))
        ]
        own = [text for text, plugin in built if {*owner} >= {*foreign_classes(plugin)}]
        return own or [text for text, _ in built]

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


def _refuse_repeats(scenes: Sequence[Scene]) -> None:
    for name, n in Counter(scene.name for scene in scenes).items():
        if n > 1:
            raise InputError(f"scenarios: two scenes have the name {name!r}; rename a scenario")
