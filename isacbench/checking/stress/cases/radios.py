"""Cases of radios: arrays, numerologies and frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from isacbench.checking.promises.image_promises import (
    EVERY,
    FOUND,
    INVARIANT,
    RESOLVED_ECHOES,
    Imaging,
)
from isacbench.checking.promises.promise import Promise
from isacbench.checking.promises.small_scenes import NARROW, PAPER_REGION, RESOLVED, Echo, Layout
from isacbench.checking.stress.case import CaseScene, EstimatorCase
from isacbench.checking.stress.cases.levels import SNR_DB
from isacbench.checking.stress.spaces import choice, whole
from isacbench.model.frame import PanelFrame, PaperFrame
from isacbench.model.numerology import System

SMALLEST_MAP = 11
"""Bins along an axis below which a taper or a detector's window need not fit."""


@dataclass(frozen=True)
class ArrayShape(EstimatorCase):
    """One echo without noise, seen by any array."""

    name: ClassVar[str] = "array"
    promised: ClassVar = (*EVERY, *RESOLVED_ECHOES, *INVARIANT)
    fixed: ClassVar = tuple(
        {"n_u": n_u, "n_w": n_w} for n_u, n_w in ((2, 2), (2, 32), (32, 2), (3, 7), (16, 16), (31, 9))
    )

    n_u: int = whole(2, 32, 8)
    n_w: int = whole(2, 32, 8)

    def scene(self) -> CaseScene:
        """One echo."""
        layout = Layout(array=(self.n_u, self.n_w), region=NARROW)
        return CaseScene([Echo(9.3, 0.7, 0.05, -0.08)], layout=layout)


@dataclass(frozen=True)
class Numerology(EstimatorCase):
    """Two echoes, with any number of subcarriers and of symbols: prime, odd, even, one."""

    name: ClassVar[str] = "numerology"
    fixed: ClassVar = tuple(
        {"n_subcarriers": n_subcarriers, "n_symbols": n_symbols}
        for n_subcarriers, n_symbols in ((1, 1), (1, 32), (2, 2), (64, 1), (251, 31), (97, 13), (1021, 61))
    )

    n_subcarriers: int = whole(1, 1024, 256)
    n_symbols: int = whole(1, 64, 32)
    noise: str = choice(*SNR_DB)

    @property
    def may_refuse(self) -> bool:
        """True if a taper or a detector's window may be larger than the map."""
        return min(self.n_subcarriers, self.n_symbols) < SMALLEST_MAP

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """Both echoes where the radio tells them apart."""
        both = (FOUND,) if min(self.n_subcarriers / 8, self.n_symbols) >= SMALLEST_MAP else ()
        return *EVERY, *both, *INVARIANT

    def scene(self) -> CaseScene:
        """One echo from 22 m, and one from 25 m that moves."""
        system = System(n_subcarriers=self.n_subcarriers, n_symbols=self.n_symbols)
        echoes = [
            Echo(22.0 / system.range_bin_m, 0.0, 0.1, -0.1),
            Echo(25.0 / system.range_bin_m, 15.0 / system.velocity_bin_mps, -0.15, 0.15),
        ]
        return CaseScene(echoes, SNR_DB[self.noise], Layout(system, region=NARROW))


@dataclass(frozen=True)
class Frames(EstimatorCase):
    """Resolved echoes in the paper's frame or on a turned panel."""

    name: ClassVar[str] = "frame"
    promised: ClassVar = (*EVERY, *RESOLVED_ECHOES, *INVARIANT)
    fixed: ClassVar = ({"frame": "paper"}, {"frame": "turned_panel"})

    frame: str = choice("paper", "turned_panel")

    def scene(self) -> CaseScene:
        """Two echoes."""
        frame = PaperFrame() if self.frame == "paper" else PanelFrame(yaw_deg=11.0, tilt_deg=-7.0)
        return CaseScene(RESOLVED[::2], layout=Layout(frame=frame, region=PAPER_REGION))
