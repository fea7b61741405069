"""Cases of power maps: ends of float64, dynamic range, constants, odd shapes, windows and rates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from isacbench.checking.stress.cases.detector_case import SHAPE, DetectorCase, white_noise_map
from isacbench.checking.stress.promises.map_promises import (
    EVERY_MAP,
    KNOWN_FACTOR,
    KNOWN_NOISE,
    MAP_INVARIANT,
    MAP_SINGLE_PRECISION,
    MAP_TWO_POWER_SCALE,
    NOTHING,
    RATE_ORDER,
    REFUSED,
    SMALLEST,
)
from isacbench.checking.stress.spaces import choice, real, whole

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from isacbench.checking.stress.case import Promise
    from isacbench.checking.stress.promises.map_promises import TestedMap

LARGEST = float(np.finfo(np.float64).max)


@dataclass(frozen=True)
class MapLevel(DetectorCase):
    """Noise with three echoes at any level that float64 knows."""

    name: ClassVar[str] = "map_level"
    fixed: ClassVar = tuple(
        {"exponent": float(exponent)}
        for exponent in (-323, -322, -310, -307, -300, -150, -30, 0, 30, 150, 300, 305, 306)
    )

    exponent: float = real(-323.0, 306.0, 0.0)

    @property
    def promises(self) -> tuple[Promise[TestedMap], ...]:
        """All that holds of noise."""
        return *EVERY_MAP, *MAP_INVARIANT, KNOWN_NOISE, MAP_SINGLE_PRECISION

    def power(self, seed: int) -> NDArray[np.float64]:
        """Scale noise and echoes."""
        power = np.minimum(white_noise_map(SHAPE, seed), 15.0)
        power[5, 7], power[12, 0], power[0, 16] = 100.0, 40.0, 20.0
        scaled: NDArray[np.float64] = power * 10.0**self.exponent
        return scaled


@dataclass(frozen=True)
class MapRange(DetectorCase):
    """Noise whose cells are up to 3000 dB stronger than their neighbours."""

    name: ClassVar[str] = "map_range"
    fixed: ClassVar = tuple(
        {"range_db": range_db, "strong": strong}
        for range_db in (140.0, 300.0, 3000.0)
        for strong in ("checkers", "one_cell", "half", "any")
    )

    range_db: float = real(0.0, 3000.0, 140.0)
    strong: Literal["checkers", "one_cell", "half", "any"] = choice("checkers", "one_cell", "half", "any")

    @property
    def promises(self) -> tuple[Promise[TestedMap], ...]:
        """A strong cell leaves the noise of others alone."""
        return *EVERY_MAP, *MAP_INVARIANT, KNOWN_NOISE

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
        decades = self.range_db / 10
        power: NDArray[np.float64] = white_noise_map(SHAPE, seed) * 10.0 ** (decades * share - decades / 2)
        return power


@dataclass(frozen=True)
class ConstantMap(DetectorCase):
    """The same power in every cell."""

    name: ClassVar[str] = "constant_map"
    fixed: ClassVar = tuple(
        {"exponent": exponent} for exponent in (-323.0, -310.0, -300.0, -0.3, 0.0, 77.7, 300.0, 308.0)
    )

    exponent: float = real(-323.0, 308.0, 0.0)

    @property
    def promises(self) -> tuple[Promise[TestedMap], ...]:
        """Nothing stands out."""
        return *EVERY_MAP, MAP_TWO_POWER_SCALE, KNOWN_NOISE, NOTHING

    def power(self, seed: int) -> NDArray[np.float64]:
        """Fill a map."""
        return np.full(SHAPE, 10.0**self.exponent)


@dataclass(frozen=True)
class BlankMap(DetectorCase):
    """Zeros, the smallest and the largest numbers, alone or side by side."""

    name: ClassVar[str] = "blank_map"
    fixed: ClassVar = tuple(
        {"filled": filled}
        for filled in (
            "zeros",
            "smallest",
            "largest",
            "few_smallest",
            "smallest_cell",
            "largest_cell",
            "ends",
        )
    )

    filled: Literal[
        "zeros", "smallest", "largest", "few_smallest", "smallest_cell", "largest_cell", "ends"
    ] = choice("zeros", "smallest", "largest", "few_smallest", "smallest_cell", "largest_cell", "ends")

    @property
    def promises(self) -> tuple[Promise[TestedMap], ...]:
        """Nothing stands out where all is the same."""
        nothing = (NOTHING,) if self.filled in ("zeros", "smallest", "largest") else ()
        return *EVERY_MAP, *nothing, MAP_TWO_POWER_SCALE, KNOWN_NOISE

    def power(self, seed: int) -> NDArray[np.float64]:
        """Fill a map."""
        power = np.zeros(SHAPE)
        match self.filled:
            case "smallest":
                power[:] = SMALLEST
            case "largest":
                power[:] = LARGEST
            case "few_smallest":
                power.flat[::7] = SMALLEST
            case "smallest_cell":
                power[6, 8] = SMALLEST
            case "largest_cell":
                power[6, 8] = LARGEST
            case "ends":
                power[:] = np.where(np.indices(SHAPE).sum(axis=0) % 2 == 1, LARGEST, SMALLEST)
        return power


@dataclass(frozen=True)
class MapWindow(DetectorCase):
    """Lines, maps and cubes of any size, and windows that fit them, just or not at all."""

    name: ClassVar[str] = "map_window"
    fixed: ClassVar = (
        {"n_axes": 1, "length": 1, "training": 1, "guard": 0},
        {"n_axes": 1, "length": 3, "training": 1, "guard": 0},
        {"n_axes": 1, "length": 9, "training": 3, "guard": 1},
        {"n_axes": 1, "length": 8, "training": 3, "guard": 1},
        {"n_axes": 1, "length": 41, "training": 20, "guard": 0},
        {"n_axes": 2, "length": 1, "width": 1, "training": 1, "guard": 0},
        {"n_axes": 2, "length": 9, "width": 9, "training": 3, "guard": 1},
        {"n_axes": 2, "length": 9, "width": 8, "training": 3, "guard": 1},
        {"n_axes": 2, "length": 1, "width": 41, "training": 3, "guard": 1},
        {"n_axes": 2, "length": 37, "width": 11, "training": 3, "guard": 2},
        {"n_axes": 2, "length": 13, "width": 17, "training": 20, "guard": 3},
        {"n_axes": 3, "length": 5, "width": 7, "training": 1, "guard": 1},
        {"n_axes": 3, "length": 5, "width": 4, "training": 1, "guard": 1},
    )

    n_axes: int = choice(2, 1, 3)
    length: int = whole(1, 41, 13)
    width: int = whole(1, 41, 17)
    training: int = whole(1, 20, 3)
    guard: int = whole(0, 3, 1)

    DEPTH: ClassVar[int] = 4
    """Cells along the third axis, where a window has three."""

    @property
    def promises(self) -> tuple[Promise[TestedMap], ...]:
        """Tested where the window fits, refused where it does not."""
        n_window = 2 * (self.training + self.guard) + 1
        sides = (self.length,) if self.n_axes == 1 else (self.length, self.width)
        return (*EVERY_MAP, KNOWN_NOISE) if n_window <= min(sides) else (REFUSED,)

    def parameters(self) -> Mapping[str, Any]:
        """The window."""
        training, guard = (self.training, self.training, 1), (self.guard, self.guard, 0)
        return {"training": training[: self.n_axes], "guard": guard[: self.n_axes]}

    def power(self, seed: int) -> NDArray[np.float64]:
        """Draw a map of that size."""
        return white_noise_map((self.length, self.width, self.DEPTH)[: self.n_axes], seed)


@dataclass(frozen=True)
class Rate(DetectorCase):
    """Any probability of false alarm, any number of looks, either factor."""

    name: ClassVar[str] = "rate"
    fixed: ClassVar = tuple(
        {"exponent": exponent, "looks": looks, "threshold": threshold}
        for exponent, looks, threshold in (
            (-15.0, 1, "exact"),
            (-15.0, 16, "exact"),
            (-15.0, 1024, "exact"),
            (-6.0, 2, "exact"),
            (-3.0, 256, "exact"),
            (-0.31, 1, "exact"),
            (-0.31, 16, "exact"),
            (-15.0, 1, "paper"),
            (-0.31, 1, "paper"),
        )
    )

    exponent: float = real(-15.0, -0.31, -3.0)
    looks: int = whole(1, 1024, 1)
    threshold: Literal["exact", "paper"] = choice("exact", "paper")

    ECHO: ClassVar[float] = 1000.0
    """Power above any threshold in noise of mean 1: so that cells are detected at every rate."""

    @property
    def promises(self) -> tuple[Promise[TestedMap], ...]:
        """Thresholds keep the rate, and rise as it falls."""
        return *EVERY_MAP, *MAP_INVARIANT, KNOWN_FACTOR, RATE_ORDER

    def parameters(self) -> Mapping[str, Any]:
        """Rate and kind of factor."""
        kind = {"threshold": self.threshold} if self.threshold != "exact" else {}
        return {"pfa": 10.0**self.exponent, **kind}

    def n_looks(self) -> int:
        """As many as are asked for."""
        return self.looks

    def power(self, seed: int) -> NDArray[np.float64]:
        """Draw noise of that many looks, and an echo in a corner that half of the windows do not reach."""
        power = white_noise_map((9, 11), seed, self.looks)
        power[0, 0] = self.ECHO
        return power
