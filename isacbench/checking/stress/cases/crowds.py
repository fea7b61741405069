"""Cases of few and of many: pairs that the radio cannot tell apart, coherent sources, thousands."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isacbench.checking.promises.image_promises import (
    EVERY,
    FOUND,
    INVARIANT,
    NO_FALSE_POINT,
    NO_POINT,
    RESOLVED_ECHOES,
    Imaging,
)
from isacbench.checking.promises.promise import Promise
from isacbench.checking.promises.small_scenes import RESOLVED, Echo, Shot, observed, scenario_of
from isacbench.checking.stress.case import CaseScene, EstimatorCase
from isacbench.checking.stress.cases.levels import SNR_DB
from isacbench.checking.stress.spaces import choice, real, whole
from isacbench.model.echo import central_phase, random_stream

RAYLEIGH_COSINE = 0.25
"""Rayleigh cell of the array of 8 x 8 elements, in a direction cosine."""

CELL = np.array([1.0, 1.0, RAYLEIGH_COSINE, RAYLEIGH_COSINE])
"""Rayleigh cell in range bins, Doppler bins, u and w."""

STEPS = {
    "range": (1, 0, 0, 0),
    "doppler": (0, 1, 0, 0),
    "u": (0, 0, 1, 0),
    "w": (0, 0, 0, 1),
    "all": (1,) * 4,
}
"""Directions in which two close echoes are apart."""

CANCELLING = 0.9
"""Half turns between two echoes from which hardly anything is left of them."""

UNEQUAL = 0.9
"""Ratio of the amplitudes of successive echoes: equal ones in phase have no order."""

LOWEST_SPREAD, HIGHEST_SPREAD = np.array([3.0, -4.0, -0.55, -0.55]), np.array([13.0, 4.0, 0.55, 0.55])
SPREAD_CELLS = 3.0
"""Cells between any two echoes, in range, speed or a direction."""


@dataclass(frozen=True)
class Pair(EstimatorCase):
    """Two echoes in one place, of any phase; at half a turn they cancel."""

    name: ClassVar[str] = "pair"
    fixed: ClassVar = tuple(
        {"half_turns": half_turns, "noise": noise} for half_turns in (0.0, 0.5, 1.0) for noise in SNR_DB
    )

    half_turns: float = real(0.0, 1.0, 0.0)
    noise: str = choice(*SNR_DB)

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """No more points than echoes without noise; none where they cancel."""
        if self.half_turns > CANCELLING:
            return (*EVERY, NO_POINT) if self.noise == "none" and self.half_turns == 1 else EVERY
        clear = (NO_FALSE_POINT,) if self.noise == "none" else ()
        return *EVERY, *clear, FOUND, *INVARIANT

    def scene(self) -> CaseScene:
        """Both echoes."""
        one = RESOLVED[0]
        return CaseScene([one, one._replace(phase_rad=math.pi * self.half_turns)], SNR_DB[self.noise])


@dataclass(frozen=True)
class Close(EstimatorCase):
    """Two echoes closer than any cell, in phase at the centre of the frame and of the array; no noise."""

    name: ClassVar[str] = "close"
    promised: ClassVar = (*EVERY, NO_FALSE_POINT, FOUND, *INVARIANT)
    fixed: ClassVar = tuple(
        {"exponent": exponent, "along": along} for along in STEPS for exponent in (-1.0, -3.0, -9.0)
    )

    exponent: float = real(-12.0, -1.0, -6.0)
    along: str = choice(*STEPS)

    def scene(self) -> CaseScene:
        """Both echoes."""
        one = RESOLVED[0]
        place = one[:4] + 10.0**self.exponent * CELL * STEPS[self.along]
        return CaseScene(_in_phase([one, Echo(*place.tolist())._replace(amplitude=UNEQUAL)]))


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

    def scene(self) -> CaseScene:
        """A row of echoes, as far as its directions are visible."""
        step = self.separation * RAYLEIGH_COSINE
        middle = (self.n_echoes - 1) / 2
        echoes = [
            Echo(9.2, 1.3, (k - middle) * step * 0.8, 0.1 + (k - middle) * step * 0.6, UNEQUAL**k)
            for k in range(self.n_echoes)
        ]
        return CaseScene(_in_phase([echo for echo in echoes if math.hypot(echo.u, echo.w) < 1]))


@dataclass(frozen=True)
class Crowd(EstimatorCase):
    """Many echoes, in one cell or everywhere."""

    name: ClassVar[str] = "crowd"
    promised: ClassVar = EVERY
    fixed: ClassVar = tuple(
        {"n_echoes": n_echoes, "where": where, "snr_db": snr_db}
        for where in ("region", "one_cell")
        for n_echoes, snr_db in ((12, 20.0), (100, 200.0), (5000, 20.0))
    )

    n_echoes: int = whole(1, 5000, 100)
    where: str = choice("region", "one_cell")
    snr_db: float = real(-20.0, 200.0, 20.0)

    def shot(self, seed: int) -> Shot:
        """Observe them.

        Parameters
        ----------
        seed : int
            Seed of places and noise.
        """
        stream = random_stream("stress", 0, seed, self.spec)
        lowest, highest = ((3.0, -4.0), (13.0, 4.0)) if self.where == "region" else ((8.8, 0.8), (9.2, 1.2))
        bins = stream.uniform(lowest, highest, (self.n_echoes, 2))
        radius = 0.8 * np.sqrt(stream.uniform(size=self.n_echoes))
        angle = stream.uniform(0, 2 * np.pi, self.n_echoes)
        phase = stream.uniform(0, 2 * np.pi, self.n_echoes)
        places = np.column_stack([bins, radius * np.cos(angle), radius * np.sin(angle)])
        return observed(_unit_echoes(places, phase), self.snr_db, seed)


@dataclass(frozen=True)
class Spread(EstimatorCase):
    """Equal echoes at random places of which no two share a cell; no noise."""

    name: ClassVar[str] = "spread"
    promised: ClassVar = (*EVERY, *RESOLVED_ECHOES, *INVARIANT)
    fixed: ClassVar = (
        *({"n_echoes": n_echoes, "draw": draw} for n_echoes in (2, 4, 8) for draw in (0, 1)),
        # Found by search: a spectrum's pole that a sample struck hid the other source of the cell.
        {"n_echoes": 2, "draw": 147},
        {"n_echoes": 2, "draw": 1785},
        {"n_echoes": 8, "draw": 192},
    )

    n_echoes: int = whole(1, 10, 4)
    draw: int = whole(0, 9999, 0)

    def shot(self, seed: int) -> Shot:
        """Observe them.

        Parameters
        ----------
        seed : int
            Seed of the places.
        """
        stream = random_stream("stress", self.draw, seed, "spread")
        places: list[NDArray[np.float64]] = []
        while len(places) < self.n_echoes:
            place = stream.uniform(LOWEST_SPREAD, HIGHEST_SPREAD)
            if all((np.abs(place - other) / CELL).max() >= SPREAD_CELLS for other in places):
                places.append(place)
        phase = stream.uniform(0, 2 * np.pi, self.n_echoes)
        return observed(_unit_echoes(places, phase), seed=seed)


def _unit_echoes(places: ArrayLike, phase_rad: NDArray[np.float64]) -> list[Echo]:
    """Echoes of amplitude 1 at places (n, 4): bins and direction cosines."""
    return [Echo(*row) for row in np.column_stack([places, np.ones_like(phase_rad), phase_rad]).tolist()]


def _in_phase(echoes: list[Echo]) -> list[Echo]:
    """Echoes with such phases that they are equal at the centre of the frame and of the array.

    That is where echoes closer than a Rayleigh cell are hardest to tell apart.
    """
    phases = central_phase(scenario_of(echoes))
    return [
        echo._replace(phase_rad=echo.phase_rad - float(phase))
        for echo, phase in zip(echoes, phases, strict=True)
    ]
