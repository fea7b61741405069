"""Scenes of a suite, the entries that meet them, and what entries of a scene share.

A scene is what the column ``scenario`` names: it is drawn once a trial,
observed at every SNR, and every entry meets the same observation. The
harness knows nothing else of a kind of suite.
"""

from __future__ import annotations

import dataclasses
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, Generic, Self, TypeVar

import numpy as np
import pandas as pd

from isacbench.bench.cells.cell import Found, MeasuredImage, array_digest, estimate_cloud, image_reference
from isacbench.bench.cells.record import DRAW_COLUMNS, N_STORED, Row, status_of
from isacbench.bench.plan.labels import variant_label
from isacbench.bench.suites.scenario_digest import digest, scenario_digest
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputError
from isacbench.metrics.geometry import CloudPair
from isacbench.model.cloud import PointCloud
from isacbench.model.echo import Simulator
from isacbench.model.observation import Observation
from isacbench.model.radio_coordinates import gain_db
from isacbench.model.scene import Scenario
from isacbench.plugins.contracts import Estimator, is_reference
from isacbench.plugins.registry import build_variants, canonical_params
from isacbench.plugins.scoring import PAPER_ALONE, Metrics

Measure = Callable[[MeasuredImage], Mapping[str, Any]]
"""Function of a kind that derives further columns of the row from an image."""

SNR_DECIMALS = 6
"""Digits after which an SNR is rounded, so that a gain added and taken away leaves it as it was."""

Plugin = TypeVar("Plugin")


@dataclass(frozen=True)
class Entry(Generic[Plugin]):
    """Estimator, detector or receiver of a suite, with its parameters.

    Attributes
    ----------
    name : str
        In the column ``estimator``.
    params : str
        Canonical JSON.
    labels : mapping of str to Any
        Further columns that tell it from others.
    """

    name: str
    params: str
    plugin: Plugin
    labels: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class SharedObservation(ABC):
    """Observation that every entry of a scene works on.

    Attributes
    ----------
    key : mapping of str to Any
        Key of its rows, without an entry.
    labels : mapping of str to Any
        Further columns of every row.
    n_true : int
        Number of things to be found, the column ``n_true`` of a failure.
    """

    key: Mapping[str, Any]
    labels: Mapping[str, Any]
    n_true: int

    @abstractmethod
    def digest(self) -> str:
        """Digest of the observation: another one as soon as an entry has changed it."""

    @abstractmethod
    def call(self, plugin: Any) -> Any:
        """Let a plugin work on the observation: what is timed."""

    @abstractmethod
    def score(self, plugin: Any, answer: Any) -> Found:
        """Score the answer of a call."""

    @abstractmethod
    def n_differing(self, answers: Sequence[Any], row: Row) -> int:
        """Count the answers of repeated calls that are not the one of a row."""

    def unread(self) -> Self:
        """Return an observation of which no entry has read anything."""
        return self

    def work(self, plugin: Any) -> Found:
        """Let a plugin work on the observation, and time and score it."""
        start = time.process_time()
        answer = self.call(plugin)
        time_s = time.process_time() - start
        columns, cloud = self.score(plugin, answer)
        return {"time_estimate_s": time_s, **columns}, cloud


class Scene(ABC):
    """Situation that entries meet, once for each SNR and trial.

    Parameters
    ----------
    name : str
        Unique in a run.
    entries : sequence of Entry
        All that meet every observation.
    snr_db : sequence of float
        Per resource element and virtual element.
    draw : callable
        From a trial to what its observations share. The last result is kept.

    Attributes
    ----------
    name, entries, snr_db
        As given.
    """

    def __init__(
        self,
        suite: Suite,
        name: str,
        entries: Sequence[Entry[Any]],
        snr_db: Sequence[float],
        draw: Callable[[int], Any],
    ) -> None:
        self.name, self.entries, self.snr_db, self._suite = name, entries, snr_db, suite
        self._drawn_once = lru_cache(maxsize=1)(draw)

    @property
    @abstractmethod
    def content(self) -> str:
        """Digest of what its rows follow from besides entry, SNR, trial and seed."""

    @abstractmethod
    def observe(self, snr_db: float, trial: int) -> SharedObservation:
        """Observe once, for all entries."""

    def forget(self) -> None:
        """Let go of what was kept for further observations."""
        self._drawn_once.cache_clear()

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


@dataclass(frozen=True, eq=False)
class SharedImage(SharedObservation):
    """Observation that estimators image.

    Attributes
    ----------
    scenario : Scenario
        With the scatterers that were observed.
    measure : callable or None
        Measures further columns of an image.
    metrics : Metrics
        Score the images.
    """

    scenario: Scenario
    observation: Observation
    measure: Measure | None
    metrics: Metrics = PAPER_ALONE

    def digest(self) -> str:
        """Digest of the observation."""
        shown = self.observation
        arrays = shown.cells, shown.gate.range_bins, shown.gate.doppler_bins, shown.base_station_m
        bounds = shown.gate.reachable_range, shown.gate.reachable_doppler
        known = *map(_values, (shown.system, shown.array, shown.frame, shown.region)), shown.sensing
        return digest([repr((bounds, known)), *map(array_digest, arrays)])

    def call(self, plugin: Estimator) -> PointCloud:
        """Image of the observation."""
        return estimate_cloud(plugin, self.observation, self.scenario.truth)

    def score(self, plugin: Estimator, answer: PointCloud) -> Found:
        """Score an image."""
        start = time.perf_counter()
        scores = self.metrics.score(CloudPair.of(self.scenario, answer))
        columns = {**scores, **self._measured(plugin, answer)}
        return {**columns, "time_score_s": time.perf_counter() - start}, answer

    def n_differing(self, answers: Sequence[PointCloud], row: Row) -> int:
        """Count the images that are not that of a row."""
        cloud = row.cloud.to_array()
        return sum(not np.array_equal(answer.to_array(), cloud) for answer in answers)

    def unread(self) -> Self:
        """Return the observation without what it remembers."""
        return dataclasses.replace(self, observation=dataclasses.replace(self.observation))

    def work(self, plugin: Estimator) -> Found:
        """Image and score the observation; of a reference, score the realisations of the scenario."""
        if not is_reference(plugin):
            return super().work(plugin)
        image = image_reference(plugin, self.scenario, self.metrics)
        start = time.perf_counter()
        measured = self._measured(plugin, image.cloud)
        return {
            **image.columns(),
            N_STORED: float(len(image.cloud)),
            **measured,
            "time_estimate_s": image.time_estimate_s,
            "time_score_s": image.time_score_s + time.perf_counter() - start,
        }, image.cloud

    def _measured(self, plugin: Estimator, cloud: PointCloud) -> dict[str, Any]:
        """Status of an image, and further columns."""
        shot = MeasuredImage(self.scenario, self.observation, plugin, self.key["snr_db"], cloud)
        return {"status": status_of(len(cloud)), **(self.measure(shot) if self.measure else {})}


def _values(part: object) -> tuple[str, object]:
    """Type and values of a part of an observation, with all digits, whatever its own ``repr`` shows."""
    if dataclasses.is_dataclass(part) and not isinstance(part, type):
        return type(part).__name__, dataclasses.astuple(part)
    return type(part).__name__, part


class ImagedScene(Scene):
    """Scene that estimators image: the same in every trial, or drawn anew.

    An `InputError` if nothing can be scored, for there are no scatterers.

    Parameters
    ----------
    scenario : Scenario
        The scene, or what draws have in common.
    entries : sequence of Entry
        Estimators.
    name : str, optional
        Of the scene, where one scenario makes several.
    draw : callable, optional
        From a trial to its scenario.
    simulator : callable, optional
        From a scenario to what observes it; by default with the whole grid.
    measure : callable, optional
        Measures further columns of an image.
    metrics : Metrics, optional
        Score the images.
    labels : mapping of str to Any
        Further columns of every row.

    Attributes
    ----------
    template : Scenario
        The `scenario`.
    measure, metrics, labels
        As given.
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
        first = self.drawn(0)
        if not len(first.scatterers):
            raise InputError(f"scenarios: {scenario.name!r} has no scatterers, so that nothing can be scored")
        snrs_db = element_snrs_db(suite, gain_db(first))
        super().__init__(
            suite, name or scenario.name, entries, snrs_db, lambda trial: simulator(self.drawn(trial))
        )

    @cached_property
    def content(self) -> str:
        """Digest of the first scenario drawn, and of what the rows are labelled with."""
        return digest([scenario_digest(self.drawn(0)), self._suite.kind, dict(self.labels)])

    def observe(self, snr_db: float, trial: int) -> SharedImage:
        """Observe once, for all estimators."""
        simulator = self._drawn_once(trial if self.is_drawn else 0)
        scenario = simulator.scenario
        return SharedImage(
            self._key(snr_db, trial),
            {**self.labels, "snr_gain_db": gained_snr_db(snr_db, gain_db(scenario))},
            len(scenario.truth),
            scenario,
            simulator.observe(snr_db, trial, self._suite.seed),
            self.measure,
            self.metrics,
        )

    def draws(self, n_trials: int) -> pd.DataFrame:
        """Tabulate the scatterers of the first trials, none where every trial has the same."""
        if not self.is_drawn:
            return super().draws(n_trials)
        tables = []
        for trial in range(n_trials):
            drawn = self.drawn(trial)
            truth, phase_rad = drawn.truth.to_dataframe(), drawn.scatterers.phase_rad
            tables.append(truth.assign(scenario=self.name, trial=trial, phase_rad=phase_rad))
        return pd.concat(tables, ignore_index=True)[DRAW_COLUMNS]

    def drawn(self, trial: int) -> Scenario:
        """Scenario of a trial."""
        return self.template if self._draw is None else self._draw(trial)


def build_estimators(suite: Suite) -> list[Entry[Estimator]]:
    """Build the estimators of a suite, every variant of its grids.

    Raises
    ------
    InputError
        If one is unknown, or two have equal parameters.
    """
    variants: list[tuple[str, Estimator]] = []
    for spec in suite.estimators:
        own = suite.instances.get(spec)
        variants += build_variants("estimator", spec) if own is None else [(spec, own)]
    return distinct_entries("estimator", ((text, entry_of(plugin)) for text, plugin in variants))


def entry_of(plugin: Any, **labels: Any) -> Entry[Any]:
    """Entry of a plugin, with further columns that tell it from others."""
    params = canonical_params(plugin)
    return Entry(plugin.name, params, plugin, {"label": variant_label(plugin.name, params), **labels})


def distinct_entries(what: str, written: Iterable[tuple[str, Entry[Plugin]]]) -> list[Entry[Plugin]]:
    """List entries, each given with what the suite writes for it, and refuse two with equal parameters.

    `what` they are: ``"estimator"``, ``"detector"`` or ``"receiver"``.
    """
    found: dict[tuple[str, str], Entry[Plugin]] = {}
    for text, entry in written:
        if (entry.name, entry.params) in found:
            article = "an" if what.startswith("e") else "a"
            raise InputError(f"{what}s: {text!r} repeats {article} {what} with equal parameters")
        found[entry.name, entry.params] = entry
    return list(found.values())


def element_snrs_db(suite: Suite, gain: float) -> list[float]:
    """SNRs of a suite per resource element and virtual element, of a scene with some gain in dB."""
    if suite.snr_gain_db is None:
        return list(suite.snr_db or ())
    return [round(snr_db - gain, SNR_DECIMALS) for snr_db in suite.snr_gain_db]


def gained_snr_db(snr_db: float, gain: float) -> float:
    """SNR after a gain in dB."""
    return round(snr_db + gain, SNR_DECIMALS) + 0.0
