"""Cases of few and of many: nothing, pairs that the radio cannot tell apart, coherent sources, thousands."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from isacbench.checking.stress.cases.estimator_case import EstimatorCase
from isacbench.checking.stress.cases.resolved_shots import RESOLVED, Echo, observed, scenario_of
from isacbench.checking.stress.promises.image_promises import (
    EVERY,
    FOUND,
    INVARIANT,
    NO_FALSE_POINT,
    NO_POINT,
    RESOLVED_ECHOES,
)
from isacbench.checking.stress.spaces import choice, real, whole
from isacbench.model.echo import central_phase, random_stream

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from isacbench.checking.contract.small_scenes import Shot
    from isacbench.checking.stress.case import Promise
    from isacbench.checking.stress.promises.image_promises import Imaging

RAYLEIGH_COSINE = 0.25
"""Of the array of 8 x 8 elements."""

CANCELLING = 0.9
"""Half turns between two echoes from which hardly anything is left of them."""

UNEQUAL = 0.9
"""Amplitude of an echo over the one before it: which of equal ones in phase comes first, nothing decides."""

LOWEST_SPREAD, HIGHEST_SPREAD = np.array([3.0, -4.0, -0.55, -0.55]), np.array([13.0, 4.0, 0.55, 0.55])
CELL_SPREAD = np.array([1.0, 1.0, RAYLEIGH_COSINE, RAYLEIGH_COSINE])
SPREAD_CELLS = 3.0
"""Cells between any two echoes, in range, speed or a direction."""


@dataclass(frozen=True)
class Nothing(EstimatorCase):
    """No scatterer: noise of any level, or not even that."""

    name: ClassVar[str] = "nothing"
    fixed: ClassVar = (
        {"noise": "none"},
        *({"noise": "white", "exponent": float(exponent)} for exponent in (-140, -20, 0, 20, 140)),
    )

    noise: Literal["none", "white"] = choice("none", "white")
    exponent: float = real(-140.0, 140.0, 0.0)

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """No point where there is nothing at all."""
        return (*EVERY, NO_FALSE_POINT, *INVARIANT) if self.noise == "none" else (*EVERY, *INVARIANT)

    def shot(self, seed: int) -> Shot:
        """Observe nothing."""
        return observed([], math.inf if self.noise == "none" else -20 * self.exponent, seed)


@dataclass(frozen=True)
class Pair(EstimatorCase):
    """Two echoes in one place, of any phase; at half a turn nothing is left of them."""

    name: ClassVar[str] = "pair"
    fixed: ClassVar = tuple(
        {"half_turns": half_turns, "noise": noise}
        for half_turns in (0.0, 0.5, 1.0)
        for noise in ("none", "20dB")
    )

    half_turns: float = real(0.0, 1.0, 0.0)
    noise: Literal["none", "20dB"] = choice("none", "20dB")

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """No more points than echoes without noise; none where they cancel."""
        if self.half_turns > CANCELLING:
            return (*EVERY, NO_POINT) if self.noise == "none" and self.half_turns == 1 else EVERY
        clear = (NO_FALSE_POINT,) if self.noise == "none" else ()
        return *EVERY, *clear, FOUND, *INVARIANT

    def shot(self, seed: int) -> Shot:
        """Observe both."""
        one = RESOLVED[0]
        two = one._replace(phase_rad=math.pi * self.half_turns)
        return observed([one, two], math.inf if self.noise == "none" else 20.0, seed)


@dataclass(frozen=True)
class Close(EstimatorCase):
    """Two echoes closer than any cell, in phase at the centre of the frame and of the array; no noise."""

    name: ClassVar[str] = "close"
    fixed: ClassVar = tuple(
        {"exponent": float(exponent), "along": along}
        for along in ("range", "doppler", "u", "w", "all")
        for exponent in (-1, -3, -6, -9)
    )

    exponent: float = real(-12.0, -1.0, -6.0)
    along: Literal["range", "doppler", "u", "w", "all"] = choice("range", "doppler", "u", "w", "all")

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """One point or two, where they are."""
        return *EVERY, NO_FALSE_POINT, FOUND, *INVARIANT

    def shot(self, seed: int) -> Shot:
        """Observe both."""
        cells = 10.0**self.exponent
        one = RESOLVED[0]
        moved = {
            "range": {"range_bin": one.range_bin + cells},
            "doppler": {"doppler_bin": one.doppler_bin + cells},
            "u": {"u": one.u + cells * RAYLEIGH_COSINE},
            "w": {"w": one.w + cells * RAYLEIGH_COSINE},
        }
        everywhere = {key: value for change in moved.values() for key, value in change.items()}
        other = one._replace(**(everywhere if self.along == "all" else moved[self.along]), amplitude=UNEQUAL)
        return observed(
            in_phase([one, other]),
            seed=seed,
        )


@dataclass(frozen=True)
class Coherent(EstimatorCase):
    """Echoes of one range and one speed, exactly coherent, in a row over directions; no noise."""

    name: ClassVar[str] = "coherent"
    fixed: ClassVar = tuple(
        {"n_echoes": n_echoes, "separation": separation}
        for n_echoes in (2, 3)
        for separation in (0.3, 0.6, 1.0, 1.5)
    )

    n_echoes: int = whole(2, 6, 2)
    separation: float = real(0.0, 2.0, 1.0)

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """No more points than echoes where they are resolved."""
        resolved = (NO_FALSE_POINT,) if self.separation >= 1.5 and self.n_echoes <= 3 else ()
        return *EVERY, *resolved, *INVARIANT

    def shot(self, seed: int) -> Shot:
        """Observe them."""
        step = self.separation * RAYLEIGH_COSINE
        middle = (self.n_echoes - 1) / 2
        echoes = [
            Echo(9.2, 1.3, (k - middle) * step * 0.8, 0.1 + (k - middle) * step * 0.6, UNEQUAL**k)
            for k in range(self.n_echoes)
        ]
        visible = [echo for echo in echoes if math.hypot(echo.u, echo.w) < 1]
        return observed(in_phase(visible), seed=seed)


@dataclass(frozen=True)
class Crowd(EstimatorCase):
    """Many echoes, in one cell or everywhere."""

    name: ClassVar[str] = "crowd"
    fixed: ClassVar = tuple(
        {"n_echoes": n_echoes, "where": where, "snr_db": snr_db}
        for where in ("region", "one_cell")
        for n_echoes, snr_db in ((1, 20.0), (12, 20.0), (100, 20.0), (5000, 20.0), (100, 200.0))
    )

    n_echoes: int = whole(1, 5000, 100)
    where: Literal["region", "one_cell"] = choice("region", "one_cell")
    snr_db: float = real(-20.0, 200.0, 20.0)

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """A cloud, and the same again: in a crowd a tie may fall either way."""
        return EVERY

    def shot(self, seed: int) -> Shot:
        """Observe them."""
        stream = random_stream("stress", 0, seed, self.spec)
        lowest, highest = ((3.0, -4.0), (13.0, 4.0)) if self.where == "region" else ((8.8, 0.8), (9.2, 1.2))
        bins = stream.uniform(lowest, highest, (self.n_echoes, 2))
        radius = 0.8 * np.sqrt(stream.uniform(size=self.n_echoes))
        angle = stream.uniform(0, 2 * np.pi, self.n_echoes)
        phase = stream.uniform(0, 2 * np.pi, self.n_echoes)
        echoes = [
            Echo(*map(float, values))
            for values in zip(
                *bins.T,
                radius * np.cos(angle),
                radius * np.sin(angle),
                np.ones_like(phase),
                phase,
                strict=True,
            )
        ]
        return observed(echoes, self.snr_db, seed)


@dataclass(frozen=True)
class Spread(EstimatorCase):
    """Equal echoes at random places of which no two share a cell; no noise."""

    name: ClassVar[str] = "spread"
    fixed: ClassVar = (
        *({"n_echoes": n_echoes, "draw": draw} for n_echoes in (2, 4, 8) for draw in (0, 1, 2)),
        # Found by search: a spectrum's pole that a sample struck hid the other source of the cell.
        {"n_echoes": 2, "draw": 147},
        {"n_echoes": 2, "draw": 1785},
        {"n_echoes": 8, "draw": 192},
    )

    n_echoes: int = whole(1, 10, 4)
    draw: int = whole(0, 9999, 0)

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """A point an echo."""
        return *EVERY, *RESOLVED_ECHOES, *INVARIANT

    def shot(self, seed: int) -> Shot:
        """Observe them."""
        stream = random_stream("stress", self.draw, seed, "spread")
        places: list[NDArray[np.float64]] = []
        while len(places) < self.n_echoes:
            place = stream.uniform(LOWEST_SPREAD, HIGHEST_SPREAD)
            cells = [np.abs(place - other) / CELL_SPREAD for other in places]
            if all(apart.max() >= SPREAD_CELLS for apart in cells):
                places.append(place)
        phases = stream.uniform(0, 2 * np.pi, self.n_echoes)
        columns = np.column_stack([places, np.ones_like(phases), phases])
        echoes = [Echo(*values) for values in columns.tolist()]
        return observed(echoes, seed=seed)


def in_phase(echoes: list[Echo]) -> list[Echo]:
    """Echoes with such phases that they are equal at the centre of the frame and of the array.

    That is where echoes closer than a Rayleigh cell are hardest to tell apart.
    """
    phases = central_phase(scenario_of(echoes))
    return [
        echo._replace(phase_rad=echo.phase_rad - float(phase))
        for echo, phase in zip(echoes, phases, strict=True)
    ]
