"""Cases of power maps: levels, dynamic range, constants, odd shapes, windows and rates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from isacbench.checking.promises import map_promises
from isacbench.checking.promises.map_promises import EVERY_MAP, MAP_INVARIANT, TestedMap, white_noise_map
from isacbench.checking.promises.promise import Promise
from isacbench.checking.stress.case import DetectorCase
from isacbench.checking.stress.spaces import choice, real, whole

SHAPE = 13, 17
"""Shape of an ordinary map: primes, and larger than the windows by default."""


@dataclass(frozen=True)
class MapLevel(DetectorCase):
    """Noise with three echoes at any level, up to the squares of the largest float32."""

    name: ClassVar[str] = "map_level"
    promised: ClassVar = (*EVERY_MAP, *MAP_INVARIANT, map_promises.MAP_SINGLE_PRECISION)
    fixed: ClassVar = tuple({"exponent": exponent} for exponent in (-76.0, -30.0, 0.0, 30.0, 76.0))

    exponent: float = real(-76.0, 76.0, 0.0)

    def power(self, seed: int) -> NDArray[np.float64]:
        """Scale noise and echoes."""
        power = np.minimum(white_noise_map(SHAPE, seed), 15.0)
        power[5, 7], power[12, 0], power[0, 16] = 100.0, 40.0, 20.0
        scaled: NDArray[np.float64] = power * 10.0**self.exponent
        return scaled


@dataclass(frozen=True)
class MapRange(DetectorCase):
    """Noise whose cells are up to 300 dB stronger than their neighbours."""

    name: ClassVar[str] = "map_range"
    promised: ClassVar = (*EVERY_MAP, *MAP_INVARIANT)
    fixed: ClassVar = tuple(
        {"range_db": range_db, "strong": strong}
        for range_db in (140.0, 300.0)
        for strong in ("checkers", "one_cell", "half", "any")
    )

    range_db: float = real(0.0, 300.0, 140.0)
    strong: str = choice("checkers", "one_cell", "half", "any")

    def power(self, seed: int) -> NDArray[np.float64]:
        """Make some cells strong."""
        share = np.zeros(SHAPE)
        match self.strong:
            case "checkers":
                share[np.indices(SHAPE).sum(axis=0) % 2 == 1] = 1.0
            case "one_cell":
                share[6, 8] = 1.0
            case "half":
                share[:, 9:] = 1.0
            case "any":
                share = np.random.default_rng([seed, 1]).random(SHAPE)
        return white_noise_map(SHAPE, seed) * 10.0 ** (self.range_db / 10 * (share - 0.5))


@dataclass(frozen=True)
class BlankMap(DetectorCase):
    """Zeros, the same power in every cell, or zeros but for one cell or for every seventh."""

    name: ClassVar[str] = "blank_map"
    fixed: ClassVar = (
        {"filled": "zeros"},
        *({"filled": "constant", "exponent": exponent} for exponent in (-76.0, -0.3, 0.0, 76.0)),
        {"filled": "one_cell"},
        {"filled": "few_cells"},
    )

    filled: str = choice("zeros", "constant", "one_cell", "few_cells")
    exponent: float = real(-76.0, 76.0, 0.0)

    @property
    def promises(self) -> tuple[Promise[TestedMap], ...]:
        """Nothing is detected where all cells are equal."""
        nothing = (map_promises.NOTHING,) if self.filled in ("zeros", "constant") else ()
        return *EVERY_MAP, *nothing, map_promises.MAP_TWO_POWER_SCALE

    def power(self, seed: int) -> NDArray[np.float64]:
        """Fill a map.

        Parameters
        ----------
        seed : int
            Of no effect.
        """
        power = np.zeros(SHAPE)
        match self.filled:
            case "constant":
                power[:] = 10.0**self.exponent
            case "one_cell":
                power[6, 8] = 10.0**self.exponent
            case "few_cells":
                power.flat[::7] = 10.0**self.exponent
        return power


@dataclass(frozen=True)
class MapWindow(DetectorCase):
    """Lines and maps of any size, and windows that fit them, just or not at all."""

    name: ClassVar[str] = "map_window"
    fixed: ClassVar = (
        {"n_axes": 1, "length": 3, "training": 1, "guard": 0},
        {"n_axes": 1, "length": 9, "training": 3, "guard": 1},
        {"n_axes": 1, "length": 8, "training": 3, "guard": 1},
        {"n_axes": 2, "length": 1, "width": 1, "training": 1, "guard": 0},
        {"n_axes": 2, "length": 9, "width": 9, "training": 3, "guard": 1},
        {"n_axes": 2, "length": 9, "width": 8, "training": 3, "guard": 1},
        {"n_axes": 2, "length": 37, "width": 11, "training": 3, "guard": 2},
        {"n_axes": 2, "length": 13, "width": 17, "training": 20, "guard": 3},
    )

    n_axes: int = choice(2, 1)
    length: int = whole(1, 41, 13)
    width: int = whole(1, 41, 17)
    training: int = whole(1, 20, 3)
    guard: int = whole(0, 3, 1)

    @property
    def promises(self) -> tuple[Promise[TestedMap], ...]:
        """Tested where the window fits, refused where it does not."""
        n_window = 2 * (self.training + self.guard) + 1
        return EVERY_MAP if n_window <= min(self._shape()) else (map_promises.REFUSED,)

    def parameters(self) -> Mapping[str, Any]:
        """Training and guard cells per side."""
        return {"training": self.training, "guard": self.guard}

    def power(self, seed: int) -> NDArray[np.float64]:
        """Draw a map of that size."""
        return white_noise_map(self._shape(), seed)

    def _shape(self) -> tuple[int, ...]:
        return (self.length, self.width)[: self.n_axes]


@dataclass(frozen=True)
class Rate(DetectorCase):
    """Any probability of false alarm, and any number of looks."""

    name: ClassVar[str] = "rate"
    promised: ClassVar = (*EVERY_MAP, *MAP_INVARIANT, map_promises.FALSE_ALARM_RATE, map_promises.RATE_ORDER)
    fixed: ClassVar = tuple(
        {"exponent": exponent, "looks": looks}
        for exponent, looks in ((-15.0, 1), (-15.0, 1024), (-2.0, 1), (-3.0, 256), (-0.31, 1), (-0.31, 16))
    )

    exponent: float = real(-15.0, -0.31, -3.0)
    looks: int = whole(1, 1024, 1)

    ECHO: ClassVar[float] = 1000.0
    """Power above any threshold in noise of mean 1: so that cells are detected at every rate."""

    def parameters(self) -> Mapping[str, Any]:
        """Probability of false alarm."""
        return {"pfa": 10.0**self.exponent}

    def n_looks(self) -> int:
        """Looks that each cell averages."""
        return self.looks

    def power(self, seed: int) -> NDArray[np.float64]:
        """Draw noise of that many looks, and an echo in a corner that half of the windows do not reach."""
        power = white_noise_map((9, 11), seed, self.looks)
        power[0, 0] = self.ECHO
        return power
