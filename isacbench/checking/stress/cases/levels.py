"""Cases of levels: noise, amplitudes, dynamic range, rates, precision, and cells of one value."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from isacbench.bench.cells.cell import raw_cloud
from isacbench.checking.promises import image_promises
from isacbench.checking.promises.image_promises import EVERY, FOUND, INVARIANT, RESOLVED_ECHOES, Imaging
from isacbench.checking.promises.promise import Promise
from isacbench.checking.promises.small_scenes import (
    NARROW,
    RESOLVED,
    Layout,
    Shot,
    observed,
    scenario_of,
    with_cells,
)
from isacbench.checking.stress.case import Case, CaseScene, EstimatorCase
from isacbench.checking.stress.spaces import choice, real
from isacbench.model.echo import Simulator
from isacbench.plugins.contracts import Estimator
from isacbench.plugins.discovery import PluginKind
from isacbench.plugins.scoring import score

CLEAR_DB = 60.0
"""SNR from which noise excuses neither a false point nor a wrong power."""

SEEN_DB = 0.0
"""SNR from which every echo is seen."""

FOUND_DB = 10.0
"""Level below the strongest echo down to which every estimator is expected to see a resolved one."""

SNR_DB = {"none": math.inf, "20dB": 20.0}
"""SNR by the word for the noise."""

N_TRIALS = 12
STEPS_DB = 5.0
N_STEPS = 8
LEVEL = 0.01
"""Probability that any step of a ladder that falls is taken for a bump."""

SMALL_BINS = 0.3
"""Bound on the mean sum of three Hausdorff distances, 35 dB above the foot of the usual ladder."""

START_DB = -25.0

NEGLIGIBLE_BINS = 1e-3
"""Range bins of error that are ignored: the bias of superposed echoes moves with the noise."""


@dataclass(frozen=True)
class Snr(EstimatorCase):
    """Three resolved echoes at any SNR."""

    name: ClassVar[str] = "snr"
    fixed: ClassVar = tuple({"snr_db": float(snr_db)} for snr_db in (-80, -10, 0, 20, 60, 200))

    snr_db: float = real(-80.0, 200.0, 20.0)

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """Invariance at all levels; every echo, and nothing else, where the noise is weak."""
        seen = (FOUND,) if self.snr_db >= SEEN_DB else ()
        clear = (image_promises.NO_FALSE_POINT, image_promises.POWER) if self.snr_db >= CLEAR_DB else ()
        return *EVERY, *seen, *clear, *INVARIANT

    def scene(self) -> CaseScene:
        """Three echoes at that SNR."""
        return CaseScene(RESOLVED, self.snr_db)


@dataclass(frozen=True)
class Amplitude(EstimatorCase):
    """Three resolved echoes of any amplitude that float32 holds, without noise or far above it."""

    name: ClassVar[str] = "amplitude"
    promised: ClassVar = (*EVERY, *RESOLVED_ECHOES, image_promises.POWER, *INVARIANT)
    fixed: ClassVar = (
        {"exponent": -30.0, "noise": "none"},
        {"exponent": 30.0, "noise": "none"},
        {"exponent": 30.0, "noise": "weak"},
    )

    exponent: float = real(-30.0, 30.0, 0.0)
    noise: str = choice("none", "weak")

    def scene(self) -> CaseScene:
        """Three echoes of that amplitude."""
        echoes = [echo._replace(amplitude=10.0**self.exponent) for echo in RESOLVED]
        return CaseScene(echoes, math.inf if self.noise == "none" else CLEAR_DB)


@dataclass(frozen=True)
class DynamicRange(EstimatorCase):
    """An echo, and a weaker one in its own cell, in a neighbouring one or far away; no noise."""

    name: ClassVar[str] = "dynamic_range"
    fixed: ClassVar = tuple(
        {"level_db": float(level_db), "where": where}
        for where in ("own_cell", "next_range", "next_doppler", "far")
        for level_db in (3, 60, 140)
    )

    level_db: float = real(0.0, 140.0, 20.0)
    where: str = choice("own_cell", "next_range", "next_doppler", "far")

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """The strong echo, no more than the two, and both where the weak one is resolved and strong."""
        both = (FOUND,) if self.level_db <= FOUND_DB and self.where == "far" else ()
        return *EVERY, image_promises.NO_FALSE_POINT, image_promises.FOUND_FIRST, *both, *INVARIANT

    def scene(self) -> CaseScene:
        """The strong echo and the weak one."""
        strong = RESOLVED[1]
        bins = {"own_cell": (0, 0), "next_range": (1, 0), "next_doppler": (0, 1), "far": (-4, -4)}[self.where]
        weak = strong._replace(
            range_bin=strong.range_bin + bins[0],
            doppler_bin=strong.doppler_bin + bins[1],
            u=strong.u - 0.8,
            w=strong.w + 0.7,
            amplitude=10 ** (-self.level_db / 20),
        )
        return CaseScene([strong, weak])


@dataclass(frozen=True)
class FalseAlarms(EstimatorCase):
    """Resolved echoes at any probability of false alarm."""

    name: ClassVar[str] = "pfa"
    promised: ClassVar = (*EVERY, FOUND, *INVARIANT)
    fixed: ClassVar = tuple(
        {"exponent": exponent, "noise": noise} for exponent in (-15.0, -0.302) for noise in SNR_DB
    )

    exponent: float = real(-15.0, -0.302, -3.0)
    noise: str = choice(*SNR_DB)

    def parameters(self) -> dict[str, float]:
        """Probability of false alarm."""
        return {"pfa": 10.0**self.exponent}

    def scene(self) -> CaseScene:
        """Three echoes."""
        return CaseScene(RESOLVED, SNR_DB[self.noise])


@dataclass(frozen=True)
class SinglePrecision(EstimatorCase):
    """Resolved echoes in single precision."""

    name: ClassVar[str] = "single_precision"
    promised: ClassVar = (*EVERY, FOUND, image_promises.SINGLE_PRECISION)
    fixed: ClassVar = tuple({"snr_db": float(snr_db)} for snr_db in (0, 20, 140))

    snr_db: float = real(0.0, 200.0, 20.0)

    def scene(self) -> CaseScene:
        """Three echoes at that SNR."""
        return CaseScene(RESOLVED, self.snr_db)


@dataclass(frozen=True)
class Blank(EstimatorCase):
    """Cells of one value, or zeros but for a cell, an element or every second cell."""

    name: ClassVar[str] = "map"
    fixed: ClassVar = (
        {"filled": "zeros"},
        *(
            {"filled": filled, "exponent": exponent}
            for filled in ("constant", "one_cell", "one_element", "checkers", "loud_element")
            for exponent in (-30.0, 30.0)
        ),
    )

    filled: str = choice("zeros", "constant", "one_cell", "one_element", "checkers", "loud_element")
    exponent: float = real(-30.0, 30.0, 0.0)

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """A cloud; an empty one of zeros."""
        empty = (image_promises.NO_FALSE_POINT,) if self.filled == "zeros" else ()
        return *EVERY, *empty, image_promises.THREADS, image_promises.LAYOUT

    def shot(self, seed: int) -> Shot:
        """Fill the cells of a gate."""
        shot = observed([], 0.0, seed, Layout(region=NARROW))
        cells = np.zeros_like(shot.seen.cells)
        level = 10.0**self.exponent
        middle = cells.shape[0] // 2, cells.shape[1] // 2
        match self.filled:
            case "constant":
                cells[:] = level
            case "one_cell":
                cells[middle] = level
            case "one_element":
                cells[*middle, 1, 1] = level
            case "loud_element":
                cells[:] = shot.seen.cells
                cells[*middle, 1, 1] = level
            case "checkers":
                cells[::2, ::2] = cells[1::2, 1::2] = level
        return with_cells(shot, cells)


@dataclass(frozen=True, eq=False)
class Ladder:
    """An estimator, and a scene that it images at rising SNR.

    Attributes
    ----------
    snr_db : tuple of float
        Ascending.
    """

    estimator: Estimator
    simulator: Simulator
    snr_db: tuple[float, ...]
    seed: int

    @cached_property
    def errors_bins(self) -> NDArray[np.float64]:
        """Sums (rungs, trials) of the Hausdorff distances, in range bins."""
        errors_m = [[self._error_m(snr_db, trial) for trial in range(N_TRIALS)] for snr_db in self.snr_db]
        return np.array(errors_m) / self.simulator.scenario.system.range_bin_m

    def _error_m(self, snr_db: float, trial: int) -> float:
        scenario = self.simulator.scenario
        observation = self.simulator.observe(snr_db, trial, self.seed)
        cloud = raw_cloud(self.estimator, observation, scenario.truth)
        scores = score(scenario.truth, cloud, region=scenario.region)
        return sum(scores[f"hausdorff_{plane}_m"] for plane in ("xy", "xz", "yz"))


def _last_error_bins(ladder: Ladder) -> float:
    """Mean error on the last rung."""
    return float(ladder.errors_bins[-1].mean())


def _largest_bump(ladder: Ladder) -> float:
    """Largest rise of the mean error, in range bins, beyond its confidence interval."""
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
    echoes: str = choice("one", "three")

    @property
    def promises(self) -> tuple[Promise[Ladder], ...]:
        """Errors that fall, and are small at last."""
        falls = Promise("error falls with SNR", NEGLIGIBLE_BINS, _largest_bump)
        if self.from_db < START_DB:
            return (falls,)
        return falls, Promise("small error at last", SMALL_BINS, _last_error_bins)

    def subject(self, plugin: Estimator, seed: int) -> Ladder:
        """Set up the ladder."""
        scenario = scenario_of(RESOLVED[:1] if self.echoes == "one" else RESOLVED)
        levels_db = tuple(self.from_db + STEPS_DB * step for step in range(N_STEPS))
        return Ladder(plugin, Simulator(scenario), levels_db, seed)
