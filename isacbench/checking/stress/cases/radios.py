"""Cases of radios: arrays, subarrays, numerologies, frames, cubes, and probabilities of false alarm."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from isacbench.checking.stress.case import Promise
from isacbench.checking.stress.cases.estimator_case import EstimatorCase
from isacbench.checking.stress.cases.resolved_shots import NARROW, RESOLVED, Echo, Layout, observed
from isacbench.checking.stress.promises.image_promises import (
    EVERY,
    FOUND,
    INVARIANCE,
    INVARIANT,
    RESOLVED_ECHOES,
)
from isacbench.checking.stress.spaces import choice, real, whole
from isacbench.cubes.frame_observation import observe_cube
from isacbench.cubes.opening import open_cube
from isacbench.cubes.transform import GateTransform
from isacbench.model.echo import resource_grid
from isacbench.model.frame import PanelFrame, PaperFrame
from isacbench.model.numerology import System
from isacbench.model.region import Region
from isacbench.plugins.registry import get_detector

if TYPE_CHECKING:
    from collections.abc import Mapping

    from isacbench.checking.contract.small_scenes import Shot
    from isacbench.checking.stress.promises.image_promises import Imaging

LONE_DB = 20.0

MAP_CELLS = 25
"""Doppler cells of the maps that the default layout has, two of its 27 bins lost to the taper."""

DETECTOR_CELLS = 11
"""Bins along an axis from which a window of 9 cells fits on what a taper leaves of the map."""


TILE_BYTES = 2**10, 2**14, 2**24
"""From less than a line of the cube to all of it."""


@dataclass(frozen=True)
class ArrayShape(EstimatorCase):
    """One echo without noise, seen by any array."""

    name: ClassVar[str] = "array"
    fixed: ClassVar = tuple(
        {"n_u": n_u, "n_w": n_w}
        for n_u, n_w in (
            (2, 2),
            (2, 3),
            (3, 3),
            (2, 32),
            (32, 2),
            (3, 7),
            (5, 4),
            (16, 16),
            (31, 9),
            (32, 32),
        )
    )

    n_u: int = whole(2, 32, 8)
    n_w: int = whole(2, 32, 8)

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """One echo, one point."""
        return *EVERY, *RESOLVED_ECHOES, *INVARIANT

    def shot(self, seed: int) -> Shot:
        """Observe it."""
        echo = Echo(9.3, 0.7, 0.05, -0.08)
        return observed([echo], seed=seed, layout=Layout(array=(self.n_u, self.n_w), region=NARROW))


@dataclass(frozen=True)
class Subarray(EstimatorCase):
    """One echo, read in subarrays from two elements to all of them; for estimators that smooth."""

    name: ClassVar[str] = "subarray"
    fixed: ClassVar = tuple(
        {"fraction": fraction, "n_u": n_u, "n_w": n_w}
        for n_u, n_w in ((8, 8), (5, 12), (3, 2))
        for fraction in (0.01, 0.5, 0.75, 1.0)
    )

    fraction: float = real(0.01, 1.0, 0.625)
    n_u: int = whole(2, 16, 8)
    n_w: int = whole(2, 16, 8)

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """One echo, one point."""
        return *EVERY, *RESOLVED_ECHOES, *INVARIANT

    def parameters(self) -> Mapping[str, Any]:
        """Share of the array that a subarray takes."""
        return {"subarray_fraction": self.fraction}

    def shot(self, seed: int) -> Shot:
        """Observe it."""
        return observed(
            [Echo(9.3, 0.7, 0.05, -0.08)], seed=seed, layout=Layout(array=(self.n_u, self.n_w), region=NARROW)
        )


@dataclass(frozen=True)
class Numerology(EstimatorCase):
    """Two echoes, with any number of subcarriers and of symbols: prime, odd, even, one."""

    name: ClassVar[str] = "numerology"
    fixed: ClassVar = tuple(
        {"n_subcarriers": n_subcarriers, "n_symbols": n_symbols}
        for n_subcarriers, n_symbols in (
            (1, 1), (1, 32), (2, 2), (3, 3), (64, 1), (251, 31), (255, 33), (97, 13), (256, 2), (7, 64),
            (1021, 61),
        )
    )  # fmt: skip

    n_subcarriers: int = whole(1, 1024, 256)
    n_symbols: int = whole(1, 64, 32)
    noise: Literal["none", "20dB"] = choice("none", "20dB")

    @property
    def may_refuse(self) -> bool:
        """Whether a taper or the detector, of 9 x 9 cells by default, is larger than the map."""
        return min(self.n_subcarriers, self.n_symbols) < DETECTOR_CELLS

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """Something is found where the radio tells both echoes apart."""
        both = (FOUND,) if min(self.n_subcarriers / 8, self.n_symbols) >= DETECTOR_CELLS else ()
        return *EVERY, *both, *INVARIANT

    def parameters(self) -> Mapping[str, Any]:
        """A window of 3 x 3 cells where the usual one would be larger than the map."""
        if 3 <= min(self.n_subcarriers, self.n_symbols) < DETECTOR_CELLS:
            return {"detector": get_detector("osca", training=1, order_axis=1)}
        return {}

    def shot(self, seed: int) -> Shot:
        """Observe one echo from 22 m, and one from 25 m that moves, if the radio can tell speeds."""
        system = System(n_subcarriers=self.n_subcarriers, n_symbols=self.n_symbols)
        echoes = [
            Echo(22.0 / system.range_bin_m, 0.0, 0.1, -0.1),
            Echo(25.0 / system.range_bin_m, 15.0 / system.velocity_bin_mps, -0.15, 0.15),
        ]
        layout = Layout(system=system, region=NARROW)
        return observed(echoes, math.inf if self.noise == "none" else LONE_DB, seed, layout)


@dataclass(frozen=True)
class Frames(EstimatorCase):
    """Resolved echoes in the paper's frame or on a turned panel."""

    name: ClassVar[str] = "frame"
    fixed: ClassVar = ({"frame": "paper"}, {"frame": "turned_panel"})

    frame: Literal["paper", "turned_panel"] = choice("paper", "turned_panel")

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """One echo, one point."""
        return *EVERY, *RESOLVED_ECHOES, *INVARIANT

    def shot(self, seed: int) -> Shot:
        """Observe them."""
        frame = PaperFrame() if self.frame == "paper" else PanelFrame(yaw_deg=11.0, tilt_deg=-7.0)
        region = Region((-25.0, 45.0), (-10.0, 50.0), (-23.0, 11.5), (-60.0, 60.0))
        return observed(RESOLVED[::2], seed=seed, layout=Layout(frame=frame, region=region))


@dataclass(frozen=True)
class FalseAlarms(EstimatorCase):
    """Resolved echoes at any probability of false alarm."""

    name: ClassVar[str] = "pfa"
    fixed: ClassVar = tuple(
        {"exponent": exponent, "noise": noise}
        for exponent in (-15.0, -6.0, -1.0, -0.302)
        for noise in ("none", "20dB")
    )

    exponent: float = real(-15.0, -0.302, -3.0)
    noise: Literal["none", "20dB"] = choice("none", "20dB")

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """All echoes are found."""
        return *EVERY, FOUND, *INVARIANT

    def parameters(self) -> Mapping[str, Any]:
        """Probability of false alarm."""
        return {"pfa": 10.0**self.exponent}

    def shot(self, seed: int) -> Shot:
        """Observe them."""
        return observed(RESOLVED, math.inf if self.noise == "none" else LONE_DB, seed)


@dataclass(frozen=True)
class DetectorWindow(EstimatorCase):
    """Resolved echoes, detected with training cells from one to more than the map has: refused, or imaged."""

    name: ClassVar[str] = "window"
    fixed: ClassVar = tuple({"training": training} for training in (1, 2, 5, 8, 12, 40))

    training: int = whole(1, 64, 4)

    @property
    def may_refuse(self) -> bool:
        """Whether the window has more cells than the map."""
        return 2 * self.training + 1 > MAP_CELLS

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """All echoes are found."""
        return *EVERY, FOUND, *INVARIANT

    def parameters(self) -> Mapping[str, Any]:
        """Detector of range-Doppler cells."""
        return {"detector": get_detector("osca", training=self.training, order_axis=1)}

    def shot(self, seed: int) -> Shot:
        """Observe them."""
        return observed(RESOLVED, LONE_DB, seed)


def _chunk_drift(imaging: Imaging) -> float:
    """Images of the recorded frame, in any order and in tiles of any size, against the closed form."""
    scenario, gate = imaging.shot.scenario, imaging.shot.seen.gate
    elements = scenario.array.positions
    cube = resource_grid(scenario, elements).reshape(
        scenario.system.n_subcarriers, scenario.system.n_symbols, *scenario.array.shape
    )
    elements_first = np.ascontiguousarray(cube.transpose(2, 3, 0, 1)).transpose(2, 3, 0, 1)
    drifts = []
    for laid in (cube, np.asfortranarray(cube), elements_first):
        drifts.append(imaging.drift(imaging.image(observe_cube(laid, scenario, workers=1))))
        for tile_bytes in TILE_BYTES:
            with open_cube(laid, tile_bytes=tile_bytes) as opened:
                cells = GateTransform(gate, scenario.system).cells(opened, elements, None, 2)
            drifts.append(imaging.drift(imaging.image_of(cells.reshape(imaging.shot.seen.cells.shape))))
    return max(drifts)


@dataclass(frozen=True)
class Chunks(EstimatorCase):
    """A recorded frame of resolved echoes, of any size and order in memory, without noise."""

    name: ClassVar[str] = "cube"
    fixed: ClassVar = (
        {"n_subcarriers": 64, "n_symbols": 16},
        {"n_subcarriers": 61, "n_symbols": 17},
    )

    n_subcarriers: int = whole(16, 128, 64)
    n_symbols: int = whole(12, 32, 16)

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """The image of the closed form."""
        return *EVERY, FOUND, Promise("chunk size", INVARIANCE, _chunk_drift)

    def shot(self, seed: int) -> Shot:
        """Observe the closed form."""
        system = System(n_subcarriers=self.n_subcarriers, n_symbols=self.n_symbols)
        echoes = [
            Echo(22.0 / system.range_bin_m, 0.0, 0.1, -0.1),
            Echo(25.0 / system.range_bin_m, 15.0 / system.velocity_bin_mps, -0.15, 0.15),
        ]
        return observed(echoes, seed=seed, layout=Layout(system=system, region=NARROW))
