"""Studies: what a kind of suite makes of its scenarios, and what it measures beside the scores.

A study expands a suite into scenes. A scene is what the column `scenario`
names: it is drawn once a trial, observed at every SNR, and every entry
meets the same observation. The harness knows nothing else.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

import numpy as np
import pandas as pd

from isacbench.bench.cells.cell import estimate_cloud, failure, run_cell
from isacbench.bench.cells.isolation import array_digest
from isacbench.bench.cells.radio_coordinates import gain_db
from isacbench.bench.cells.record import DRAW_COLUMNS, Cell
from isacbench.bench.cells.timing import Trial, timed
from isacbench.bench.suites.scenario_digest import digest, scenario_digest
from isacbench.errors import InputError
from isacbench.model.echo import Simulator
from isacbench.plugins.contracts import Estimator
from isacbench.plugins.registry import build_estimators_of, canonical_params

if TYPE_CHECKING:
    from isacbench.bench.cells.cell import Measure
    from isacbench.bench.cells.record import CellStatus, Outcome
    from isacbench.bench.suites.suite import Suite
    from isacbench.model.cloud import PointCloud
    from isacbench.model.observation import Observation
    from isacbench.model.scene import Scenario

SNR_DECIMALS = 6
"""Digits after which an SNR is rounded, so that a gain added and taken away leaves it as it was."""

Plugin = TypeVar("Plugin")
SuiteT = TypeVar("SuiteT", bound="Suite", contravariant=True)


@dataclass(frozen=True)
class Entry(Generic[Plugin]):
    """Estimator, detector or receiver of a suite, with its parameters.

    Attributes
    ----------
    name : str
        In the column ``estimator``.
    params : str
        Canonical JSON.
    plugin : Estimator or Detector
    labels : mapping of str to Any
        Further columns that tell it from others.
    """

    name: str
    params: str
    plugin: Plugin
    labels: Mapping[str, Any] = field(default_factory=dict)

    def cell(self, of: Cell) -> Cell:
        """Key of its row, given the key that it shares with the others."""
        return dataclasses.replace(of, estimator=self.name, params=self.params)


class Scene(Protocol):
    """What one name in the column ``scenario`` stands for."""

    @property
    def name(self) -> str:
        """Unique in a run."""

    @property
    def content(self) -> str:
        """Digest of what its rows follow from beside entry, SNR, trial and seed."""

    @property
    def snr_db(self) -> Sequence[float]:
        """SNRs, per resource element and virtual element."""

    @property
    def entries(self) -> Sequence[Entry[Any]]:
        """Who meets every observation."""

    def observe(self, snr_db: float, trial: int) -> SharedObservation:
        """Observe once, for all entries."""

    def forget(self) -> None:
        """Let go of what was kept for further observations."""

    def draws(self, n_trials: int) -> pd.DataFrame:
        """Scatterers that were drawn, a row each, with the columns of `Results.draws`."""


class SharedObservation(Protocol):
    """One observation, which every entry of a scene meets."""

    def meet(self, entry: Entry[Any]) -> Outcome:
        """Let an entry have its try; whatever it raises becomes a row."""

    def time_repeats(
        self, entry: Entry[Any], met: Outcome, n: int, before_each: Callable[[], None]
    ) -> Outcome:
        """Outcome of an entry that has met the observation, with the times of `n` repeats.

        `before_each` is called before each of them.
        """

    def failure_row(self, entry: Entry[Any], status: CellStatus, reason: str, time_s: float) -> Outcome:
        """Row of an entry that left no other trace."""

    def digest(self) -> str:
        """Digest of what entries are shown: another one as soon as one of them has changed it."""


class Study(Protocol[SuiteT]):
    """A kind of suite."""

    @property
    def columns(self) -> Mapping[str, Any]:
        """Columns that its rows have beside the pinned ones, each with the value of a failure."""

    def scenes(self, suite: SuiteT, scenarios: Mapping[str, Scenario]) -> Sequence[Scene]:
        """Scenes of a suite, given its scenarios by name.

        Raises
        ------
        InputError
            If the suite cannot be run on them.
        """


@dataclass(frozen=True, eq=False)
class SharedImage:
    """An observation that estimators image.

    Attributes
    ----------
    cell : Cell
        Key of its rows, without an estimator.
    scenario : Scenario
        With the scatterers that were observed.
    observation : Observation
    measure : callable or None
        What to measure beside the scores.
    labels : mapping of str to Any
        Further columns of every row.
    """

    cell: Cell
    scenario: Scenario
    observation: Observation
    measure: Measure | None
    labels: Mapping[str, Any]

    def meet(self, entry: Entry[Estimator]) -> Outcome:
        """Let an estimator image the observation."""
        cell = entry.cell(self.cell)
        outcome = run_cell(cell, self.scenario, self.observation, entry.plugin, self.measure)
        return outcome.labelled({**self.labels, **entry.labels})

    def time_repeats(
        self, entry: Entry[Estimator], met: Outcome, n: int, before_each: Callable[[], None]
    ) -> Outcome:
        """Let an estimator image the observation again and again, each time as if it had never been read."""

        def prepare() -> Observation:
            before_each()
            return dataclasses.replace(self.observation)  # what an observation remembers is not passed on

        def estimate(observation: Observation) -> PointCloud:
            return estimate_cloud(entry.plugin, observation, self.scenario.truth)

        def is_same(cloud: PointCloud) -> bool:
            return np.array_equal(cloud.to_array(), met.cloud.to_array())

        outcome = timed(met, entry.cell(self.cell), Trial(prepare, estimate), n, is_same)
        return outcome.labelled({**self.labels, **entry.labels})

    def failure_row(self, entry: Entry[Estimator], status: CellStatus, reason: str, time_s: float) -> Outcome:
        """Row of an estimator that left no other trace."""
        outcome = failure(entry.cell(self.cell), status, reason, len(self.scenario.truth), time_s)
        return outcome.labelled({**self.labels, **entry.labels})

    def digest(self) -> str:
        """Digest of the observation."""
        shown = self.observation
        arrays = shown.cells, shown.gate.range_bins, shown.gate.doppler_bins, shown.base_station_m
        bounds = shown.gate.reachable_range, shown.gate.reachable_doppler
        known = *map(_values, (shown.system, shown.array, shown.frame, shown.region)), shown.sensing
        return digest([repr((bounds, known)), *map(array_digest, arrays)])


def _values(part: object) -> tuple[str, object]:
    """Type and values of a part of an observation, with all digits, whatever its own ``repr`` shows."""
    if dataclasses.is_dataclass(part) and not isinstance(part, type):
        return type(part).__name__, dataclasses.astuple(part)
    return type(part).__name__, part


class ImagedScene:
    """A scene that estimators image: the same in every trial, or drawn anew.

    Parameters
    ----------
    suite : Suite
    scenario : Scenario
        The scene, or what draws have in common.
    entries : sequence of Entry
        Estimators.
    snr_db : sequence of float
    name : str, optional
        Of the scene, where one scenario makes several.
    draw : callable, optional
        Scenario of a trial.
    simulator : callable, optional
        What observes a scenario; by default with the whole grid.
    measure : callable, optional
        What to measure beside the scores.
    labels : mapping of str to Any
        Further columns of every row.

    Attributes
    ----------
    template : Scenario
        The `scenario`.
    measure, labels
        As given.
    """

    def __init__(
        self,
        suite: Suite,
        scenario: Scenario,
        entries: Sequence[Entry[Estimator]],
        snr_db: Sequence[float],
        *,
        name: str | None = None,
        draw: Callable[[int], Scenario] | None = None,
        simulator: Callable[[Scenario], Simulator] = Simulator,
        measure: Measure | None = None,
        labels: Mapping[str, Any] | None = None,
    ) -> None:
        self.name = scenario.name if name is None else name
        self.snr_db = snr_db
        self.entries = entries
        self._suite = suite
        self.template = scenario
        self._draw = draw
        self._observing = simulator
        self.measure = measure
        self.labels = labels or {}
        self._observed: tuple[int, Simulator] | None = None

    @cached_property
    def content(self) -> str:
        """Digest of the first scenario drawn, and of what the rows are labelled with."""
        return digest([scenario_digest(self.drawn(0)), self._suite.kind, dict(self.labels)])

    def observe(self, snr_db: float, trial: int) -> SharedImage:
        """Observe once, for all estimators."""
        simulator, suite = self._simulator(trial), self._suite
        gained = gained_snr_db(snr_db, gain_db(simulator.scenario))
        return SharedImage(
            cell=Cell(suite.name, self.name, "", "", snr_db, trial, suite.seed, self.content),
            scenario=simulator.scenario,
            observation=simulator.observe(snr_db, trial, suite.seed),
            measure=self.measure,
            labels={**self.labels, "snr_gain_db": gained},
        )

    def forget(self) -> None:
        """Let go of echo and noise."""
        self._observed = None

    def draws(self, n_trials: int) -> pd.DataFrame:
        """Scatterers of the first trials, none where every trial has the same."""
        tables = [pd.DataFrame(columns=DRAW_COLUMNS)]
        for trial in range(n_trials if self._draw is not None else 0):
            drawn = self.drawn(trial)
            table = drawn.truth.to_dataframe()
            table.insert(0, "scenario", self.name)
            table.insert(1, "trial", trial)
            tables.append(table.assign(phase_rad=drawn.scatterers.phase_rad))
        return pd.concat(tables[1:] or tables, ignore_index=True)

    @property
    def is_drawn(self) -> bool:
        """Whether every trial has scatterers of its own."""
        return self._draw is not None

    def drawn(self, trial: int) -> Scenario:
        """Scenario of a trial."""
        return self.template if self._draw is None else self._draw(trial)

    def _simulator(self, trial: int) -> Simulator:
        """Simulator of a trial; the last one is kept, and what does not change with the trial."""
        if self._observed is None or (self._draw is not None and self._observed[0] != trial):
            self._observed = trial, self._observing(self.drawn(trial))
        return self._observed[1]


def build_estimators(suite: Suite) -> list[Entry[Estimator]]:
    """Estimators of a suite, every variant of its grids.

    Raises
    ------
    InputError
        If one is unknown, or two have equal parameters.
    """
    built: dict[tuple[str, str], Entry[Estimator]] = {}
    for spec in suite.estimators:
        one = suite.instances.get(spec)
        for variant, estimator in build_estimators_of(spec) if one is None else [(spec, one)]:
            key = estimator.name, canonical_params(estimator)
            if key in built:
                raise InputError(f"estimators: {variant!r} repeats an estimator with equal parameters")
            built[key] = Entry(*key, estimator)
    return list(built.values())


def element_snrs_db(suite: Suite, gain: float) -> list[float]:
    """SNRs of a suite per resource element and virtual element, for a scene of some gain in dB."""
    if suite.snr_gain_db is None:
        return list(suite.snr_db or ())
    return [round(snr_db - gain, SNR_DECIMALS) for snr_db in suite.snr_gain_db]


def gained_snr_db(snr_db: float, gain: float) -> float:
    """SNR after a gain in dB."""
    return round(snr_db + gain, SNR_DECIMALS) + 0.0
