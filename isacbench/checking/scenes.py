"""Small scenes of the contract check and of stress, each observed in milliseconds."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from isacbench.errors import InputWarning
from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator
from isacbench.model.frame import Frame, FrameName, PanelFrame, PaperFrame, get_frame
from isacbench.model.numerology import System
from isacbench.model.observation import Observation
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers, Scenario

SYSTEM = System(n_subcarriers=256, n_symbols=32)
"""Range bins of 2.4 m, velocity bins of 12.8 m/s."""

BASE_STATION_M = 10.0, 50.0, 12.0

REGION = Region((-25.0, 45.0), (15.0, 50.0), (-23.0, 47.0), (-60.0, 60.0))
"""All directions in front of the base station."""

PAPER_REGION = Region((-25.0, 45.0), (-10.0, 50.0), (-23.0, 11.5), (-60.0, 60.0))
"""Directions below the base station, which the paper's frame tells apart."""

NARROW = Region((5.0, 15.0), (25.0, 35.0), (7.0, 17.0), (-20.0, 20.0))
"""Few cells: fast, and fine enough for almost any radio."""

SPECK = Region((10.0, 10.05), (10.0, 10.05), (3.0, 3.05), (0.0, 0.1))
"""One reachable range-Doppler cell."""


class Echo(NamedTuple):
    """A scatterer as the radio sees it: bins, direction cosines, amplitude, phase in radians."""

    range_bin: float
    doppler_bin: float
    u: float
    w: float
    amplitude: float = 1.0
    phase_rad: float = 0.0


LONE_SYSTEM = System(n_subcarriers=512, n_symbols=64)
LONE_BASE_STATION_M = 0.0, 0.0, 50.0
LONE_SPEED_MPS = -27.0, 27.0
LONE_VIEWS: dict[FrameName, tuple[Region, Echo]] = {
    "panel": (
        Region((-26.5, 26.5), (-18.5, -9.0), (23.5, 76.5), LONE_SPEED_MPS),
        Echo(24.79, 3.75, 0.8, 0.25),
    ),
    "paper": (
        Region((-23.0, 23.0), (-23.0, 23.0), (16.5, 32.0), LONE_SPEED_MPS),
        Echo(30.21, -3.75, -0.25, 0.8, amplitude=0.01),
    ),
}
"""Region and lone scatterer, by frame.

Its places with wrong signs, or with u and w swapped, lie in the region as well, more than two Rayleigh
cells away. No place is near the middle of a gate, and on each axis the two differ. The nearest bins are as
much above the true ones in the one view as they are below in the other, so that half a bin too much or too
little shows in their mean. The amplitudes differ, so that a power that follows the amplitude, or its
logarithm, differs from a power that lacks a factor.
"""

RESOLVED = (Echo(6.3, -2.2, -0.45, 0.31), Echo(9.7, 1.4, 0.5, -0.42), Echo(12.4, 3.1, 0.1, 0.55))
"""Three echoes that differ in range, velocity and direction."""


class Layout(NamedTuple):
    """The radio and the region of a scene."""

    system: System = SYSTEM
    array: tuple[int, int] = (8, 8)
    frame: Frame = PanelFrame()
    region: Region = REGION
    base_station_m: tuple[float, float, float] = BASE_STATION_M


@dataclass(frozen=True, eq=False)
class SmallScene:
    """A scenario and its observation, which is read-only."""

    scenario: Scenario
    observation: Observation

    def fresh_observation(self, *, writable: bool = True) -> Observation:
        """Copy the observation, with arrays that may be written to, or not."""
        fresh = copy.deepcopy(self.observation)
        for array in (fresh.cells, fresh.base_station_m, fresh.gate.range_bins, fresh.gate.doppler_bins):
            array.setflags(write=writable)
        return fresh

    def with_cells(self, cells: NDArray[np.complexfloating[Any, Any]]) -> SmallScene:
        """Replace the cells, an array of shape (n_range, n_doppler, P, Q)."""
        return replace(self, observation=replace(self.observation, cells=cells))


def scenario_of(echoes: Sequence[Echo], layout: Layout = Layout()) -> Scenario:  # noqa: B008, immutable
    """Scenario of echoes, which may lie outside the region."""
    columns: NDArray[np.float64] = np.array(echoes, dtype=np.float64).reshape(-1, 6)
    range_bin, doppler_bin, u, w, amplitude, phase_rad = columns.T
    base_station_m = np.array(layout.base_station_m)
    xyz = base_station_m + layout.frame.offsets(range_bin * layout.system.range_bin_m, u, w)
    velocity_mps = doppler_bin * layout.system.velocity_bin_mps
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)  # strays are on purpose
        return Scenario(
            name="stress",
            system=layout.system,
            array=VirtualArray((1, 1), layout.array, 1, 1),
            frame=layout.frame,
            base_station_m=base_station_m,
            region=layout.region,
            scatterers=Scatterers(xyz, velocity_mps, amplitude, phase_rad),
        )


def observed(
    echoes: Sequence[Echo],
    snr_db: float = np.inf,
    seed: int = 0,
    layout: Layout = Layout(),  # noqa: B008, immutable
) -> SmallScene:
    """Observe echoes, by default without noise."""
    scenario = scenario_of(echoes, layout)
    return SmallScene(scenario, Simulator(scenario).observe(snr_db, seed=seed))


# Scenes of the contract check.

SNR_DB = 5.0
LONE_SNR_DB = 20.0
SIX = Layout(array=(6, 6))


PLACES_EXCHANGED = [one._replace(u=one.w, w=one.u, doppler_bin=-one.doppler_bin) for one in RESOLVED]

CONTRACT: dict[str, tuple[Sequence[Echo], float, int, Layout]] = {
    "ordinary": (RESOLVED, SNR_DB, 0, SIX),
    "other": (PLACES_EXCHANGED, SNR_DB - 10, 1, SIX),
    "paper frame": (RESOLVED[::2], SNR_DB, 0, Layout(frame=PaperFrame(), region=PAPER_REGION)),
    "minimal gate": (
        [Echo(41.0 / SYSTEM.range_bin_m, 0.0, 0.0, 0.22)],
        SNR_DB,
        0,
        SIX._replace(region=SPECK),
    ),
    "noise alone": ([], SNR_DB, 0, SIX),
    "2 x 2 array": (RESOLVED, SNR_DB, 0, Layout(array=(2, 2))),
    "7 x 3 array": (RESOLVED, SNR_DB, 0, Layout(array=(7, 3))),
    "3 x 7 array": (RESOLVED, SNR_DB, 0, Layout(array=(3, 7))),
}
"""Echoes, SNR, seed and layout by name; "other" has the shape of "ordinary", and ten times its noise."""


@cache
def contract_scene(name: str) -> SmallScene:
    """Observe a scene of `CONTRACT`, or "silence": zeros."""
    if name == "silence":
        noise = contract_scene("noise alone")
        return noise.with_cells(np.zeros_like(noise.observation.cells))
    return observed(*CONTRACT[name])


@cache
def lone(frame: FrameName) -> SmallScene:
    """One scatterer far above the noise, in a region that holds its mirror images as well."""
    region, echo = LONE_VIEWS[frame]
    layout = Layout(LONE_SYSTEM, (10, 10), get_frame(frame), region, LONE_BASE_STATION_M)
    return observed([echo], LONE_SNR_DB, layout=layout)
