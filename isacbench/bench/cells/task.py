"""Tasks of a suite: what is observed, who works on the observation, and how answers are scored.

A task is what the column ``scenario`` names. Its scatterers are drawn once a trial and observed at every
SNR, and all entries work on the same observation. The harness knows nothing else of a kind of suite.
"""

from __future__ import annotations

import dataclasses
import time
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, Generic, TypeVar

import numpy as np
import pandas as pd

from isacbench.bench.cells.images import Found, Image, estimate_cloud, image_reference
from isacbench.bench.cells.rows import DRAW_COLUMNS, N_STORED, status_of
from isacbench.bench.labels import variant_label
from isacbench.bench.suites.scenario_digest import digest, scenario_digest
from isacbench.bench.suites.suite import Suite
from isacbench.charts import Variant
from isacbench.errors import InputError
from isacbench.metrics.geometry import CloudPair
from isacbench.model.cloud import PointCloud
from isacbench.model.echo import Simulator
from isacbench.model.radio_coordinates import gain_db
from isacbench.model.scene import Scenario
from isacbench.plugins.contracts import Estimator
from isacbench.plugins.discovery import PluginKind
from isacbench.plugins.registry import build_variants, canonical_params
from isacbench.plugins.scoring import PAPER_ALONE, Metrics, takes_empty_truth

Measure = Callable[[Image], Mapping[str, Any]]
"""Function of a kind that derives further columns of the row from an image."""

SNR_DECIMALS = 6
"""Digits after which an SNR is rounded, so that a gain added and taken away leaves it as it was."""

Plugin = TypeVar("Plugin")


@dataclass(frozen=True)
class Entry(Generic[Plugin]):
    """Estimator, detector or receiver of a suite: its name, its parameters as canonical JSON, itself.

    `labels` are further columns that tell it from others.
    """

    name: str
    params: str
    plugin: Plugin
    labels: Mapping[str, Any] = field(default_factory=dict)

    @property
    def key(self) -> Variant:
        """Name and parameters, which no other entry of the suite has."""
        return self.name, self.params


Entries = Sequence[Entry[Any]]


@dataclass(frozen=True, eq=False)
class Shared:
    """Observation that all entries of a task work on, at one SNR in one trial.

    Attributes
    ----------
    key : mapping of str to Any
        Key of its rows, without an entry.
    labels : mapping of str to Any
        Further columns of every row.
    n_true : int
        Number of things to be found, the column ``n_true`` of a failure.
    data : Observation, ndarray or ResourceGrid
        What plugins are given.
    """

    key: Mapping[str, Any]
    labels: Mapping[str, Any]
    n_true: int
    data: Any

    @cached_property
    def digest(self) -> str:
        """Digest of the data, as they are when it is first asked for."""
        return content_digest(self.data)

    def has_changed(self) -> bool:
        """Whether a plugin has changed the data, which are read-only."""
        try:
            return content_digest(self.data) != self.digest
        except Exception:  # an array may have become anything
            return True

    def unread(self) -> Shared:
        """Return a copy of which no plugin has read, and so cached, anything."""
        is_plain = not dataclasses.is_dataclass(self.data)
        return self if is_plain else dataclasses.replace(self, data=dataclasses.replace(self.data))


class Task(ABC):
    """Situation that all entries of a suite work on, once for each SNR and trial.

    Parameters
    ----------
    name : str
        Unique in a run.
    snr_db : sequence of float
        Per resource element and virtual element.
    draw : callable
        From a trial to what its observations have in common. The last result is kept.
    """

    def __init__(
        self, suite: Suite, name: str, entries: Entries, snr_db: Sequence[float], draw: Callable[[int], Any]
    ) -> None:
        self.name, self.entries, self.snr_db, self._suite = name, entries, snr_db, suite
        self._draw_once = lru_cache(maxsize=1)(draw)

    @property
    @abstractmethod
    def content(self) -> str:
        """Digest of what its rows follow from besides entry, SNR, trial and seed."""

    @abstractmethod
    def observe(self, snr_db: float, trial: int) -> Shared:
        """Observe once, for all entries."""

    @abstractmethod
    def call(self, shared: Shared, plugin: Any) -> Any:
        """Let a plugin work on the observation and return its answer: what is timed."""

    @abstractmethod
    def score(self, shared: Shared, plugin: Any, answer: Any) -> Found:
        """Score an answer; that of a reference is None, for its scores are means over realisations."""

    def entry(self, key: Variant) -> Entry[Any]:
        """Look up an entry by its key."""
        return next(one for one in self.entries if one.key == key)

    def forget(self) -> None:
        """Let go of what was kept for further observations."""
        self._draw_once.cache_clear()

    def draws(self, n_trials: int) -> pd.DataFrame:
        """Tabulate the scatterers that were drawn, with the columns `DRAW_COLUMNS`; by default none."""
        return pd.DataFrame(columns=DRAW_COLUMNS)

    def _key(self, snr_db: float, trial: int) -> dict[str, Any]:
        """Key of the rows of an observation, without an entry."""
        return {
            "suite": self._suite.name,
            "scenario": self.name,
            "snr_db": snr_db,
            "trial": trial,
            "seed": self._suite.seed,
            "scenario_content": self.content,
        }


class ImagingTask(Task):
    """Scene that estimators image: the same in every trial, or drawn anew.

    An `InputError` if nothing can be scored, for there are no scatterers.

    Parameters
    ----------
    scenario : Scenario
        The scene, or what draws have in common.
    name : str, optional
        Where one scenario makes several tasks.
    draw : callable, optional
        From a trial to its scenario.
    simulator : callable, optional
        From a scenario to what observes it; by default with the whole grid.
    measure : callable, optional
        Measures further columns of an image.
    labels : mapping of str to Any
        Further columns of every row.

    Attributes
    ----------
    template : Scenario
        The `scenario`.
    is_drawn : bool
        Whether every trial has scatterers of its own.
    """

    def __init__(
        self,
        suite: Suite,
        scenario: Scenario,
        entries: Sequence[Entry[Estimator]],
        *,
        name: str | None = None,
        draw: Callable[[int], Scenario] | None = None,
        simulator: Callable[[Scenario], Simulator] = Simulator,
        measure: Measure | None = None,
        metrics: Metrics = PAPER_ALONE,
        labels: Mapping[str, Any] | None = None,
    ) -> None:
        self.template, self.measure, self.metrics, self.labels = scenario, measure, metrics, labels or {}
        self.is_drawn = draw is not None
        self._draw = draw
        first = self.scenario_of(0)
        if not len(first.scatterers) and not any(map(takes_empty_truth, metrics.further)):
            raise InputError(f"scenarios: {scenario.name!r} has no scatterers, so that nothing can be scored")
        snrs_db = element_snrs_db(suite, gain_db(first))
        super().__init__(
            suite, name or scenario.name, entries, snrs_db, lambda trial: simulator(self.scenario_of(trial))
        )

    @cached_property
    def content(self) -> str:
        """Digest of the first scenario drawn, and of what the rows are labelled with."""
        return digest([scenario_digest(self.scenario_of(0)), self._suite.kind, dict(self.labels)])

    def observe(self, snr_db: float, trial: int) -> Shared:
        """Observe once, for all estimators."""
        simulator = self._simulator(trial)
        labels = {**self.labels, "snr_gain_db": gained_snr_db(snr_db, gain_db(simulator.scenario))}
        observation = simulator.observe(snr_db, trial, self._suite.seed)
        return Shared(self._key(snr_db, trial), labels, len(simulator.scenario.truth), observation)

    def call(self, shared: Shared, plugin: Estimator) -> PointCloud:
        """Image the observation."""
        return estimate_cloud(plugin, shared.data, self._simulator(shared.key["trial"]).scenario.truth)

    def score(self, shared: Shared, plugin: Any, answer: PointCloud | None) -> Found:
        """Score an image, or the realisations of a reference."""
        scenario, start = self._simulator(shared.key["trial"]).scenario, time.perf_counter()
        if answer is None:
            image = image_reference(plugin, scenario, self.metrics)
            # Its scores count with the time that they took when they were made.
            start, cloud = time.perf_counter() - image.time_score_s, image.cloud
            n_stored, time_s = float(len(cloud)), image.time_estimate_s
            columns = {**image.columns(), N_STORED: n_stored, "time_estimate_s": time_s}
        else:
            cloud, columns = answer, self.metrics.score(CloudPair.of(scenario, answer))
        if self.measure is not None:
            own = self.measure(Image(scenario, shared.data, plugin, shared.key["snr_db"], cloud))
            columns = {**columns, **own}
        time_score_s = time.perf_counter() - start
        return {**columns, "status": status_of(len(cloud)), "time_score_s": time_score_s}, cloud

    def draws(self, n_trials: int) -> pd.DataFrame:
        """Tabulate the scatterers of the first trials, none where every trial has the same."""
        if not self.is_drawn:
            return super().draws(n_trials)
        tables = []
        for trial in range(n_trials):
            scenario = self.scenario_of(trial)
            truth, phase_rad = scenario.truth.to_dataframe(), scenario.scatterers.phase_rad
            tables.append(truth.assign(scenario=self.name, trial=trial, phase_rad=phase_rad))
        return pd.concat(tables, ignore_index=True)[DRAW_COLUMNS]

    def scenario_of(self, trial: int) -> Scenario:
        """Scenario of a trial."""
        return self.template if self._draw is None else self._draw(trial)

    def _simulator(self, trial: int) -> Simulator:
        simulator: Simulator = self._draw_once(trial if self.is_drawn else 0)
        return simulator


def build_estimators(suite: Suite) -> list[Entry[Estimator]]:
    """Build the estimators of a suite, every variant of its grids.

    InputError if one is unknown, or two have equal parameters.
    """
    built = build_plugins(suite, "estimator", suite.estimators)
    return distinct_entries("estimator", ((text, entry_of(plugin)) for text, plugin in built))


def build_plugins(suite: Suite, kind: PluginKind, texts: Iterable[str]) -> list[tuple[str, Any]]:
    """Build plugins that a suite lists, every variant of its grids, each with its specification."""
    built: list[tuple[str, Any]] = []
    for text in texts:
        own = suite.instances.get(text)
        built += build_variants(kind, text) if own is None else [(text, own)]
    return built


def entry_of(plugin: Any, **labels: Any) -> Entry[Any]:
    """Entry of a plugin, with further columns that tell it from others."""
    params = canonical_params(plugin)
    return Entry(plugin.name, params, plugin, {"label": variant_label(plugin.name, params), **labels})


def distinct_entries(what: str, spelled_entries: Iterable[tuple[str, Entry[Plugin]]]) -> list[Entry[Plugin]]:
    """List entries, each given with what the suite writes for it, and refuse two with equal parameters.

    `what` they are: ``"estimator"``, ``"detector"`` or ``"receiver"``.
    """
    entries: dict[Variant, Entry[Plugin]] = {}
    for text, entry in spelled_entries:
        if entry.key in entries:
            article = "an" if what.startswith("e") else "a"
            raise InputError(f"{what}s: {text!r} repeats {article} {what} with equal parameters")
        entries[entry.key] = entry
    return list(entries.values())


def element_snrs_db(suite: Suite, gain: float) -> list[float]:
    """SNRs of a suite per resource element and virtual element, of a scene with some gain in dB."""
    if suite.snr_gain_db is None:
        return list(suite.snr_db or ())
    return [round(snr_db - gain, SNR_DECIMALS) for snr_db in suite.snr_gain_db]


def gained_snr_db(snr_db: float, gain: float) -> float:
    """SNR after a gain in dB."""
    return round(snr_db + gain, SNR_DECIMALS) + 0.0


def content_digest(part: object) -> str:
    """Digest of an observation or an answer, with all digits of its numbers, whatever its ``repr`` shows."""
    if isinstance(part, np.ndarray):
        raw = np.ascontiguousarray(part).reshape(-1).view(np.uint8)
        return repr((part.shape, part.dtype.str, zlib.crc32(raw.data)))
    if dataclasses.is_dataclass(part) and not isinstance(part, type):
        values = [content_digest(getattr(part, one.name)) for one in dataclasses.fields(part)]
        return digest([type(part).__name__, *values])
    return repr(part)
