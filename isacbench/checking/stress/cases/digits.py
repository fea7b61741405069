"""Cases of digits: what subspace and least-squares steps lose where they square their data."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from isacbench.checking.stress.case import BrokenPromiseError, Promise
from isacbench.checking.stress.cases.estimator_case import EstimatorCase
from isacbench.checking.stress.cases.resolved_shots import Echo, Layout, observed, with_cells
from isacbench.checking.stress.promises.image_promises import (
    EVERY,
    FOUND,
    NO_FALSE_POINT,
    NO_POINT,
    RESOLVED_ECHOES,
)
from isacbench.checking.stress.spaces import real, whole
from isacbench.instrument.remarks import Remarks

if TYPE_CHECKING:
    from collections.abc import Mapping

    from isacbench.checking.contract.small_scenes import Shot
    from isacbench.checking.stress.promises.image_promises import Imaging

WIDE_DB = 160.0
ON_BIN = Echo(9.0, 0.0, 0.15, 0.2)
LARGE = Layout(array=(16, 16))
RAYLEIGH_COSINE = 2 / 16


@dataclass(frozen=True)
class OpenedRange(EstimatorCase):
    """Two echoes in one cell, no noise, dynamic ranges opened to 160 dB; for subspace methods."""

    name: ClassVar[str] = "opened_range"
    fixed: ClassVar = tuple({"level_db": level_db} for level_db in (0.0, 40.0, 60.0, 80.0, 100.0))

    level_db: float = real(0.0, 100.0, 80.0)

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """Both: a covariance has half the digits of the weak one from 75 dB on."""
        return *EVERY, *RESOLVED_ECHOES

    def parameters(self) -> Mapping[str, Any]:
        """Limits that let it through; a subarray is what subspace methods have."""
        return {"dynamic_range_db": WIDE_DB, "local_dynamic_range_db": WIDE_DB, "subarray_fraction": 0.5}

    def shot(self, seed: int) -> Shot:
        """Observe both on a bin, where no leakage of the strong one hides the weak one."""
        weak = ON_BIN._replace(u=ON_BIN.u - 3.2 * RAYLEIGH_COSINE, amplitude=10 ** (-self.level_db / 20))
        return observed([ON_BIN, weak], seed=seed, layout=LARGE)


@dataclass(frozen=True)
class NextBeam(EstimatorCase):
    """Two equal echoes of one range and speed within a Rayleigh cell; for methods that polish."""

    name: ClassVar[str] = "next_beam"
    fixed: ClassVar = tuple(
        {"separation": separation, "phase_rad": phase_rad}
        for separation in (0.4, 0.6, 0.9)
        for phase_rad in (0.0, 1.5, math.pi)
    )

    separation: float = real(0.4, 0.95, 0.5)
    phase_rad: float = real(0.0, 3.1416, 0.0)

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """Both, to a hundredth of a Rayleigh cell."""
        return *EVERY, NO_FALSE_POINT, Promise("told apart", 0.01, FOUND.drift)

    def parameters(self) -> Mapping[str, Any]:
        """What methods have that polish."""
        return {"polish": 10}

    def shot(self, seed: int) -> Shot:
        """Observe both on a bin."""
        other = ON_BIN._replace(u=ON_BIN.u - self.separation * RAYLEIGH_COSINE, phase_rad=self.phase_rad)
        return observed([ON_BIN, other], seed=seed, layout=LARGE)


def _reported(imaging: Imaging) -> float:
    with Remarks() as remarks:
        imaging.image(imaging.shot.observation())
    if not any(count.n for count in remarks.counts.values()):
        raise BrokenPromiseError("signal and noise subspaces are not separated, and nothing is said of it")
    return 0.0


@dataclass(frozen=True)
class Unseparated(EstimatorCase):
    """A single element that hears anything: signal and noise are not separated; for subspace methods."""

    name: ClassVar[str] = "unseparated"
    fixed: ClassVar = ({"element": 3}, {"element": 4})

    element: int = whole(2, 5, 3)

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """It is reported, and no direction taken from it."""
        return *EVERY, NO_POINT, Promise("reported", 0.0, _reported)

    def parameters(self) -> Mapping[str, Any]:
        """A subarray is what subspace methods have."""
        return {"subarray_fraction": 0.5}

    def shot(self, seed: int) -> Shot:
        """Let one element hear an echo."""
        p, q = self.element, 4
        shot = observed([ON_BIN], seed=seed)
        cells = shot.seen.cells.copy()
        heard = cells[:, :, p, q].copy()
        cells[:] = 0
        cells[:, :, p, q] = heard
        return with_cells(shot, cells)
