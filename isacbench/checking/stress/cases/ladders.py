"""Cases of ladders: the error must fall from rung to rung of the SNR."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from scipy.special import stdtrit

from isacbench.bench.cells.cell import raw_cloud
from isacbench.checking.stress.case import Case, Promise
from isacbench.checking.stress.cases.resolved_shots import RESOLVED, scenario_of
from isacbench.checking.stress.spaces import choice, real
from isacbench.metrics.score import score
from isacbench.model.echo import Simulator

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from isacbench.plugins.contracts import Estimator
    from isacbench.plugins.discovery import PluginKind

N_TRIALS = 12
STEPS_DB = 5.0
N_STEPS = 8
LEVEL = 0.01
"""Probability that any step of a ladder that falls is taken for a bump."""

SMALL_BINS = 0.3
"""Of the mean sum of three Hausdorff distances, 35 dB above the foot of the usual ladder."""

START_DB = -25.0

NEGLIGIBLE_BINS = 1e-3
"""Range bins of error that count for nothing: what superposed echoes leave of bias moves with the noise."""


@dataclass(frozen=True, eq=False)
class Ladder:
    """An estimator, and a scene that it images at rising SNR.

    Attributes
    ----------
    estimator : Estimator
    simulator : Simulator
    snr_db : tuple of float
        Ascending.
    seed : int
    """

    estimator: Estimator
    simulator: Simulator
    snr_db: tuple[float, ...]
    seed: int

    @cached_property
    def errors_bins(self) -> NDArray[np.float64]:
        """Sums (rungs, trials) of the Hausdorff distances, in range bins."""
        scenario = self.simulator.scenario
        return np.array([self._errors_m(snr_db) for snr_db in self.snr_db]) / scenario.system.range_bin_m

    def _errors_m(self, snr_db: float) -> list[float]:
        scenario = self.simulator.scenario
        clouds = [
            raw_cloud(self.estimator, self.simulator.observe(snr_db, trial, self.seed), scenario.truth)
            for trial in range(N_TRIALS)
        ]
        scores = [score(scenario.truth, cloud, region=scenario.region) for cloud in clouds]
        return [sum(one[f"hausdorff_{plane}_m"] for plane in ("xy", "xz", "yz")) for one in scores]


def _last_error_bins(ladder: Ladder) -> float:
    """Mean error on the last rung."""
    return float(ladder.errors_bins[-1].mean())


def _largest_bump(ladder: Ladder) -> float:
    """Largest rise of the mean error, in range bins, that its confidence interval does not explain."""
    # The noise of a trial is the same on all rungs, so that rungs differ by their level alone.
    rises = np.diff(ladder.errors_bins, axis=0)
    width = -stdtrit(N_TRIALS - 1, LEVEL / len(rises)) / math.sqrt(N_TRIALS)
    unexplained = rises.mean(axis=1) - width * rises.std(axis=1, ddof=1)
    return max(float(unexplained.max()), 0.0)


@dataclass(frozen=True)
class SnrLadder(Case[Ladder]):
    """One resolved echo, or three, at rising SNR: the error falls, within its confidence interval."""

    name: ClassVar[str] = "ladder"
    kind: ClassVar[PluginKind] = "estimator"
    fixed: ClassVar = ({"echoes": "one"}, {"echoes": "three"}, {"echoes": "three", "from_db": 20.0})

    from_db: float = real(-40.0, 100.0, START_DB)
    echoes: Literal["one", "three"] = choice("one", "three")

    @property
    def promises(self) -> tuple[Promise[Ladder], ...]:
        """Small at last, and no bump on the way."""
        falls = Promise("error falls with SNR", NEGLIGIBLE_BINS, _largest_bump)
        if self.from_db < START_DB:
            return (falls,)
        return falls, Promise("small error at last", SMALL_BINS, _last_error_bins)

    def subject(self, plugin: Estimator, seed: int) -> Ladder:
        """Set up the ladder."""
        scenario = scenario_of(RESOLVED[:1] if self.echoes == "one" else RESOLVED)
        levels_db = tuple(self.from_db + STEPS_DB * step for step in range(N_STEPS))
        return Ladder(plugin, Simulator(scenario), levels_db, seed)
