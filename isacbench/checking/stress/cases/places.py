"""Cases of places: on bins and between them, at the edges of sight, and beyond what is unambiguous."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isacbench.checking.promises import image_promises
from isacbench.checking.promises.image_promises import EVERY, INVARIANT, RESOLVED_ECHOES, Imaging
from isacbench.checking.promises.promise import Promise
from isacbench.checking.promises.small_scenes import BASE_STATION_M, REGION, RESOLVED, SYSTEM, Echo, Layout
from isacbench.checking.stress.case import CaseScene, EstimatorCase
from isacbench.checking.stress.cases.levels import SNR_DB
from isacbench.checking.stress.spaces import choice, real
from isacbench.model.region import Region

FOUND_RADIUS = 0.98
"""Distance from straight ahead, in direction cosines, up to which an echo is promised to be found: 78.5°."""

FARTHEST_M = REGION.range_limits_m(np.array(BASE_STATION_M))[1]


@dataclass(frozen=True)
class Bin(EstimatorCase):
    """One echo at any place relative to the bins: in the middle, in the last bins, in the last of all."""

    name: ClassVar[str] = "bin"
    promised: ClassVar = (*EVERY, *RESOLVED_ECHOES, image_promises.POWER, *INVARIANT)
    fixed: ClassVar = (
        {"range_offset": 0.0, "doppler_offset": 0.0},
        {"range_offset": 0.5, "doppler_offset": 0.5},
        {"range_offset": 0.49999999, "doppler_offset": -0.50000001},
        {"range_offset": 0.5, "doppler_offset": 0.5, "where": "last_bins"},
        {"range_offset": 1.0, "doppler_offset": 1.0, "where": "last_bins"},
        {"range_offset": 0.5, "doppler_offset": -0.5, "where": "whole_map"},
        {"range_offset": 0.0, "doppler_offset": 0.99, "where": "whole_map"},
    )

    range_offset: float = real(-1.0, 1.0, 0.0)
    doppler_offset: float = real(-1.0, 1.0, 0.0)
    where: str = choice("middle", "last_bins", "whole_map")

    def scene(self) -> CaseScene:
        """One echo; the last bins are those that the region's speed limit and corner reach."""
        region = REGION
        range_bin, doppler_bin, u, w = 10.0, 1.0, 0.2, -0.3
        if self.where == "last_bins":
            u = w = (region.x_m[1] - BASE_STATION_M[0]) / FARTHEST_M
            range_bin = math.floor(FARTHEST_M / SYSTEM.range_bin_m) - 1.0
            doppler_bin = math.floor(region.speed_mps[1] / SYSTEM.velocity_bin_mps) - 1.0
        elif self.where == "whole_map":
            limit_mps = SYSTEM.unambiguous_speed_mps
            region = Region(region.x_m, region.y_m, region.z_m, (-limit_mps, limit_mps))
            doppler_bin = SYSTEM.n_symbols / 2 - 1.0
        echo = Echo(range_bin + self.range_offset, doppler_bin + self.doppler_offset, u, w)
        return CaseScene([echo], layout=Layout(region=region))


@dataclass(frozen=True)
class Direction(EstimatorCase):
    """One echo from any direction, from straight ahead to grazing."""

    name: ClassVar[str] = "direction"
    fixed: ClassVar = (
        {"radius": 0.0},
        {"radius": 1e-12},
        *({"radius": radius, "angle_deg": 30.0} for radius in (0.3, 0.8, 0.97)),
        *({"radius": FOUND_RADIUS, "angle_deg": angle_deg} for angle_deg in (0.0, 90.0, 180.0, 270.0)),
        *({"radius": 0.999, "angle_deg": angle_deg} for angle_deg in (0.0, 45.0, 225.0)),
        {"radius": 1.0 - 1e-9, "angle_deg": 30.0},
        {"radius": 1.0, "angle_deg": 0.0},
        {"radius": 1.0, "angle_deg": 90.0},
    )

    radius: float = real(0.0, 1.0, 0.0)
    angle_deg: float = real(0.0, 360.0, 0.0)

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """One echo, at most one point; found up to `FOUND_RADIUS`.

        Farther out, the errors of the direction decide on which side of the border it lies.
        """
        inner = (image_promises.FOUND, *INVARIANT) if self.radius <= FOUND_RADIUS else ()
        return *EVERY, image_promises.NO_FALSE_POINT, *inner

    def scene(self) -> CaseScene:
        """One echo."""
        angle = math.radians(self.angle_deg)
        return CaseScene([Echo(9.3, 1.2, self.radius * math.cos(angle), self.radius * math.sin(angle))])


@dataclass(frozen=True)
class Beyond(EstimatorCase):
    """An echo in the region, and one beyond the gate, the region, the prefix or an ambiguity."""

    name: ClassVar[str] = "beyond"
    fixed: ClassVar = tuple(
        {"what": what, "noise": noise}
        for what in ("gate", "region", "prefix", "range", "speed")
        for noise in SNR_DB
    )

    what: str = choice("gate", "region", "prefix", "range", "speed")
    noise: str = choice(*SNR_DB)
    excess: float = real(0.0, 1.0, 0.3)

    @property
    def promises(self) -> tuple[Promise[Imaging], ...]:
        """The echo inside is found.

        Points of what leaks in from beyond the gate, which is no echo of the
        model, may move with the last digits.
        """
        leaks = image_promises.THREADS, image_promises.LAYOUT
        return *EVERY, image_promises.FOUND_FIRST, *(leaks if self.what == "gate" else INVARIANT)

    def scene(self) -> CaseScene:
        """The echo inside and the one beyond."""
        inside = RESOLVED[0]
        farthest_bin = FARTHEST_M / SYSTEM.range_bin_m
        free_bins = SYSTEM.isi_free_range_m / SYSTEM.range_bin_m
        fastest_bin = SYSTEM.n_symbols - 3 + self.excess
        stray = {
            "gate": inside._replace(range_bin=farthest_bin + 8 + 40 * self.excess),
            "region": inside._replace(range_bin=farthest_bin + 2 * self.excess, u=0.0, w=0.0),
            "prefix": inside._replace(range_bin=(1 + self.excess) * free_bins),
            "range": inside._replace(range_bin=SYSTEM.n_subcarriers + 9 + self.excess),
            "speed": inside._replace(range_bin=10.0, doppler_bin=fastest_bin, u=0.4, w=-0.4),
        }[self.what]
        return CaseScene([inside, stray], SNR_DB[self.noise])
