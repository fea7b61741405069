"""Cases of levels: noise, amplitudes, and echoes far stronger than others."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

from isacbench.checking.stress.case import adapted
from isacbench.checking.stress.cases.estimator_case import EstimatorCase
from isacbench.checking.stress.cases.resolved_shots import RESOLVED, observed
from isacbench.checking.stress.promises.image_promises import (
    BLAS_KERNELS,
    ELEMENT_ORDER,
    EVERY,
    FOUND,
    FOUND_FIRST,
    INVARIANT,
    LAYOUT,
    NO_FALSE_POINT,
    POWER,
    RESOLVED_ECHOES,
    SINGLE_STAGES,
    THREADS,
)
from isacbench.checking.stress.spaces import choice, real

if TYPE_CHECKING:
    from isacbench.checking.contract.small_scenes import Shot
    from isacbench.checking.stress.case import Promise
    from isacbench.checking.stress.promises.image_promises import Imaging
    from isacbench.plugins.contracts import Estimator

CLEAR_DB = 60.0
"""SNR from which noise is no excuse for a false point, or for a wrong power."""

SEEN_DB = 0.0
"""SNR from which every echo is seen."""

FOUND_DB = 10.0
"""Level below the strongest echo down to which every estimator is expected to see a resolved one."""


@dataclass(frozen=True)
class Snr(EstimatorCase):
    """Three resolved echoes at any SNR."""

    name: ClassVar[str] = "snr"
    fixed: ClassVar = tuple({"snr_db": float(snr_db)} for snr_db in (-80, -40, -10, 0, 20, 60, 100, 150, 200))

    snr_db: float = real(-80.0, 200.0, 20.0)

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """Invariance at all levels; what is there, and nothing else, where it is clear."""
        seen = (FOUND,) if self.snr_db >= SEEN_DB else ()
        clear = (NO_FALSE_POINT, POWER) if self.snr_db >= CLEAR_DB else ()
        return *EVERY, *seen, *clear, *INVARIANT

    def shot(self, seed: int) -> Shot:
        """Observe the echoes."""
        return observed(RESOLVED, self.snr_db, seed)


@dataclass(frozen=True)
class Amplitude(EstimatorCase):
    """Three resolved echoes of any amplitude, without noise or far above it."""

    name: ClassVar[str] = "amplitude"
    fixed: ClassVar = tuple(
        {"exponent": float(exponent), "noise": noise}
        for exponent in (-150, -60, 60, 150)
        for noise in ("none", "weak")
    )

    exponent: float = real(-150.0, 150.0, 0.0)
    noise: Literal["none", "weak"] = choice("none", "weak")

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """All are found, and no more."""
        return *EVERY, *RESOLVED_ECHOES, POWER, THREADS, BLAS_KERNELS, LAYOUT, ELEMENT_ORDER

    def shot(self, seed: int) -> Shot:
        """Observe the echoes."""
        echoes = [echo._replace(amplitude=10.0**self.exponent) for echo in RESOLVED]
        return observed(echoes, math.inf if self.noise == "none" else CLEAR_DB, seed)


@dataclass(frozen=True)
class DynamicRange(EstimatorCase):
    """An echo, and one that much weaker in its own cell, in a neighbouring one or far away; no noise."""

    name: ClassVar[str] = "dynamic_range"
    fixed: ClassVar = tuple(
        {"level_db": float(level_db), "where": where}
        for where in ("own_cell", "next_range", "next_doppler", "far")
        for level_db in (3, 20, 60, 140)
    )

    level_db: float = real(0.0, 140.0, 20.0)
    where: Literal["own_cell", "next_range", "next_doppler", "far"] = choice(
        "own_cell", "next_range", "next_doppler", "far"
    )

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """No more than the two, the strong one always; both where the weak one is resolved and strong."""
        both = (FOUND,) if self.level_db <= FOUND_DB and self.where == "far" else ()
        return *EVERY, NO_FALSE_POINT, FOUND_FIRST, *both, *INVARIANT

    def shot(self, seed: int) -> Shot:
        """Observe the two."""
        strong = RESOLVED[1]
        apart = {"own_cell": (0, 0), "next_range": (1, 0), "next_doppler": (0, 1), "far": (-4, -4)}
        bins = apart[self.where]
        weak = strong._replace(
            range_bin=strong.range_bin + bins[0],
            doppler_bin=strong.doppler_bin + bins[1],
            u=strong.u - 0.8,
            w=strong.w + 0.7,
            amplitude=10 ** (-self.level_db / 20),
        )
        return observed([strong, weak], seed=seed)


@dataclass(frozen=True)
class SinglePrecision(EstimatorCase):
    """Resolved echoes in single precision, stage by stage."""

    name: ClassVar[str] = "single_precision"
    fixed: ClassVar = tuple({"snr_db": float(snr_db)} for snr_db in (0, 20, 60, 140))

    snr_db: float = real(0.0, 200.0, 20.0)

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """Every stage within its bound."""
        return *EVERY, FOUND, *SINGLE_STAGES

    def subject(self, plugin: Estimator, seed: int) -> Imaging:
        """Have it compute in double what it is given in either precision, if it has the choice."""
        has_choice = hasattr(plugin, "precision")
        return super().subject(adapted(plugin, {"precision": "double"}) if has_choice else plugin, seed)

    def shot(self, seed: int) -> Shot:
        """Observe the echoes."""
        return observed(RESOLVED, self.snr_db, seed)
