"""Cases of places: on bins and between them, at the edges of sight, and beyond what is unambiguous."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from isacbench.checking.stress.cases.estimator_case import EstimatorCase
from isacbench.checking.stress.cases.resolved_shots import (
    BASE_STATION_M,
    REGION,
    RESOLVED,
    SYSTEM,
    Echo,
    Layout,
    observed,
)
from isacbench.checking.stress.promises.image_promises import (
    BLAS_KERNELS,
    EVERY,
    FOUND,
    FOUND_FIRST,
    INVARIANT,
    LAYOUT,
    NO_FALSE_POINT,
    POWER,
    RESOLVED_ECHOES,
    THREADS,
)
from isacbench.checking.stress.spaces import choice, real
from isacbench.model.numerology import System
from isacbench.model.region import Region

if TYPE_CHECKING:
    from isacbench.checking.contract.small_scenes import Shot
    from isacbench.checking.stress.case import Promise
    from isacbench.checking.stress.promises.image_promises import Imaging

DEEP = Region((-300.0, 320.0), (-400.0, 50.0), (-290.0, 310.0), (-60.0, 60.0))
"""Reaches as far as the phases of subcarriers tell ranges apart: 624 m."""


@dataclass(frozen=True)
class Bin(EstimatorCase):
    """One echo at any place relative to the bins, in the middle, in the last bins, on all bins there are."""

    name: ClassVar[str] = "bin"
    fixed: ClassVar = (
        {"range_offset": 0.0, "doppler_offset": 0.0},
        {"range_offset": 0.5, "doppler_offset": 0.5},
        {"range_offset": 0.5, "doppler_offset": 0.0},
        {"range_offset": 0.49999999, "doppler_offset": -0.50000001},
        {"range_offset": 0.0, "doppler_offset": 0.0, "where": "last_bins"},
        {"range_offset": 0.5, "doppler_offset": 0.5, "where": "last_bins"},
        {"range_offset": 1.0, "doppler_offset": 1.0, "where": "last_bins"},
        {"range_offset": 0.0, "doppler_offset": 0.0, "where": "whole_map"},
        {"range_offset": 0.5, "doppler_offset": -0.5, "where": "whole_map"},
        {"range_offset": 0.0, "doppler_offset": 0.99, "where": "whole_map"},
    )

    range_offset: float = real(-1.0, 1.0, 0.0)
    doppler_offset: float = real(-1.0, 1.0, 0.0)
    where: Literal["middle", "last_bins", "whole_map"] = choice("middle", "last_bins", "whole_map")

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """One echo, one point."""
        return *EVERY, *RESOLVED_ECHOES, POWER, *INVARIANT

    def shot(self, seed: int) -> Shot:
        """Observe it; the last bins are those that the region's speed limit and corner reach."""
        system, region = SYSTEM, REGION
        range_bin, doppler_bin, u, w = 10.0, 1.0, 0.2, -0.3
        if self.where == "last_bins":
            # In the region's farthest corner.
            farthest_m = region.range_limits_m(np.array(BASE_STATION_M))[1]
            u = w = (region.x_m[1] - BASE_STATION_M[0]) / farthest_m
            range_bin = math.floor(farthest_m / system.range_bin_m) - 1.0
            doppler_bin = math.floor(region.speed_mps[1] / system.velocity_bin_mps) - 1.0
        elif self.where == "whole_map":
            limit_mps = system.unambiguous_speed_mps
            region = Region(region.x_m, region.y_m, region.z_m, (-limit_mps, limit_mps))
            doppler_bin = system.n_symbols / 2 - 1.0
        echo = Echo(range_bin + self.range_offset, doppler_bin + self.doppler_offset, u, w)
        return observed([echo], seed=seed, layout=Layout(region=region))


@dataclass(frozen=True)
class Direction(EstimatorCase):
    """One echo from any direction, from straight ahead to grazing."""

    name: ClassVar[str] = "direction"
    fixed: ClassVar = (
        {"radius": 0.0},
        {"radius": 1e-12},
        *({"radius": radius, "angle_deg": 30.0} for radius in (0.3, 0.8, 0.9, 0.97)),
        *({"radius": 0.999, "angle_deg": angle_deg} for angle_deg in (0.0, 45.0, 90.0, 180.0, 225.0, 270.0)),
        *({"radius": 1.0 - 1e-9, "angle_deg": angle_deg} for angle_deg in (0.0, 30.0, 90.0, 180.0)),
        {"radius": 1.0, "angle_deg": 0.0},
        {"radius": 1.0, "angle_deg": 90.0},
    )

    radius: float = real(0.0, 1.0, 0.0)
    angle_deg: float = real(0.0, 360.0, 0.0)

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """One echo, at most one point; found where its main lobe lies in the visible region.

        Farther out, rounding decides on which side of the border a direction lies.
        """
        inner = (FOUND, *INVARIANT) if self.radius <= 0.8 else ()
        return *EVERY, NO_FALSE_POINT, *inner

    def shot(self, seed: int) -> Shot:
        """Observe it."""
        angle = math.radians(self.angle_deg)
        echo = Echo(9.3, 1.2, self.radius * math.cos(angle), self.radius * math.sin(angle))
        return observed([echo], seed=seed)


@dataclass(frozen=True)
class Beyond(EstimatorCase):
    """An echo from where no estimator looks, or from where the radio cannot tell, beside one that it can."""

    name: ClassVar[str] = "beyond"
    fixed: ClassVar = tuple(
        {"what": what, "noise": noise}
        for what in ("gate", "region", "prefix", "range", "speed")
        for noise in ("none", "20dB")
    )

    what: Literal["gate", "region", "prefix", "range", "speed"] = choice(
        "gate", "region", "prefix", "range", "speed"
    )
    noise: Literal["none", "20dB"] = choice("none", "20dB")
    excess: float = real(0.0, 1.0, 0.3)

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """The echo inside is found.

        Points of what leaks in from beyond the gate, which is no echo of the
        model, may hang on the last digits.
        """
        return *EVERY, FOUND_FIRST, *((THREADS, BLAS_KERNELS, LAYOUT) if self.what == "gate" else INVARIANT)

    def shot(self, seed: int) -> Shot:
        """Observe both."""
        inside, system = RESOLVED[0], SYSTEM
        farthest_bin = REGION.range_limits_m(np.array(BASE_STATION_M))[1] / system.range_bin_m
        stray = {
            "gate": inside._replace(range_bin=farthest_bin + 8 + 40 * self.excess),
            "region": inside._replace(range_bin=farthest_bin + 2 * self.excess, u=0.0, w=0.0),
            "prefix": inside._replace(
                range_bin=(1 + self.excess) * system.isi_free_range_m / system.range_bin_m
            ),
            "range": inside._replace(range_bin=system.n_subcarriers + 9 + self.excess),
            "speed": inside._replace(
                range_bin=10.0, doppler_bin=system.n_symbols - 3 + self.excess, u=0.4, w=-0.4
            ),
        }[self.what]
        return observed([inside, stray], 20.0 if self.noise == "20dB" else math.inf, seed)


@dataclass(frozen=True)
class Fold(EstimatorCase):
    """One echo anywhere on all the range bins that there are, the first and the last included; no noise."""

    name: ClassVar[str] = "fold"
    fixed: ClassVar = tuple({"range_bin": range_bin} for range_bin in (0.02, 0.5, 8.0, 15.02, 15.49))

    range_bin: float = real(0.02, 15.49, 8.0)

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """One echo, one point."""
        return *EVERY, *RESOLVED_ECHOES, *INVARIANT

    def shot(self, seed: int) -> Shot:
        """Observe it from a region that is as deep as the radio sees."""
        layout = Layout(system=System(n_subcarriers=16, n_symbols=32), region=DEEP)
        return observed([Echo(self.range_bin, 1.2, 0.48, -0.48)], seed=seed, layout=layout)
