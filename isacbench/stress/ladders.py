"""Cases of ladders: the error must fall from rung to rung of the SNR."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from scipy.special import stdtrit

from isacbench.bench.cell import raw_cloud
from isacbench.metrics.score import score
from isacbench.model.echo import Simulator
from isacbench.stress.case import BrokenPromiseError, Case, Promise
from isacbench.stress.shots import RESOLVED, scenario_of
from isacbench.stress.spaces import choice, real

if TYPE_CHECKING:
    from isacbench.entries import Kind
    from isacbench.registry import AnyEstimator

__all__ = ["Ladder", "SnrLadder"]

N_TRIALS = 12
STEPS_DB = 5.0
N_STEPS = 8
LEVEL = 0.01
"""Probability that any step of a ladder that falls is taken for a bump."""

NEGLIGIBLE_BINS = 1e-3
"""Range bins of error that count for nothing: what superposed echoes leave of bias moves with the noise."""


@dataclass(frozen=True, eq=False)
class Ladder:
    """An estimator, and a scene that it images at rising SNR.

    Attributes
    ----------
    estimator : Estimator or TruthEstimator
    simulator : Simulator
    snr_db : tuple of float
        Ascending.
    seed : int
    """

    estimator: AnyEstimator
    simulator: Simulator
    snr_db: tuple[float, ...]
    seed: int

    def errors(self, snr_db: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """Sums of the Hausdorff distances in m of every trial."""
        scenario = self.simulator.scenario
        clouds = [
            raw_cloud(self.estimator, self.simulator.observe(snr_db, trial, self.seed), scenario.truth)
            for trial in range(N_TRIALS)
        ]
        scores = [score(scenario.truth, cloud, region=scenario.region) for cloud in clouds]
        return np.array([sum(one[f"hausdorff_{plane}_m"] for plane in ("xy", "xz", "yz")) for one in scores])


def _largest_bump(ladder: Ladder) -> float:
    """Largest rise of the mean error, in range bins, that its confidence interval does not explain."""
    errors = [ladder.errors(snr_db) for snr_db in ladder.snr_db]
    if not all(np.isfinite(error).all() for error in errors):
        raise BrokenPromiseError("scores are not finite")
    # The noise of a trial is the same on all rungs, so that rungs differ by their level alone.
    rises = np.diff(np.array(errors), axis=0)
    width = -stdtrit(N_TRIALS - 1, LEVEL / len(rises)) / math.sqrt(N_TRIALS)
    unexplained = rises.mean(axis=1) - width * rises.std(axis=1, ddof=1)
    return max(float(unexplained.max()), 0.0) / ladder.simulator.scenario.system.range_bin_m


@dataclass(frozen=True)
class SnrLadder(Case[Ladder]):
    """One resolved echo, or three, at rising SNR: the error falls, within its confidence interval."""

    name: ClassVar[str] = "ladder"
    kind: ClassVar[Kind] = "estimator"
    fixed: ClassVar = ({"echoes": "one"}, {"echoes": "three"}, {"echoes": "three", "from_db": 20.0})

    from_db: float = real(-40.0, 100.0, -25.0)
    echoes: Literal["one", "three"] = choice("one", "three")

    @property
    def promises(self) -> tuple[Promise[Ladder], ...]:
        """No bump."""
        return (Promise("error falls with SNR", NEGLIGIBLE_BINS, _largest_bump),)

    def subject(self, plugin: AnyEstimator, seed: int) -> Ladder:
        """Set up the ladder."""
        scenario = scenario_of(RESOLVED[:1] if self.echoes == "one" else RESOLVED)
        levels_db = tuple(self.from_db + STEPS_DB * step for step in range(N_STEPS))
        return Ladder(plugin, Simulator(scenario), levels_db, seed)
