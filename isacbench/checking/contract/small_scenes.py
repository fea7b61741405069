"""Small scenes on which estimators are checked, each observed in a millisecond."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING

import numpy as np

from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator
from isacbench.model.frame import Frame, FrameName, PanelFrame, PaperFrame, get_frame
from isacbench.model.numerology import System
from isacbench.model.observation import Observation
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers, Scenario

if TYPE_CHECKING:
    from numpy.typing import NDArray

SYSTEM = System(n_subcarriers=512, n_symbols=64)
BASE_STATION_M = np.array([10.0, 50.0, 12.0])
REGION = Region((0.0, 20.0), (0.0, 20.0), (0.0, 6.0), (-30.0, 30.0))
SPECK = Region((10.0, 10.05), (10.0, 10.05), (3.0, 3.05), (0.0, 0.1))
"""So small that one range-Doppler cell is reachable."""

ARRAY = 6, 6
THREE = ((4.0, 5.0, 1.0, 0.0), (13.0, 9.0, 3.0, 17.0), (17.0, 3.0, 5.0, -21.0))
"""Places in m and velocities in m/s of unit scatterers."""

SNR_DB = 5.0

LONE_RANGE_M = 40.0
LONE_SNR_DB = 20.0
LONE_ARRAY = 10, 10
LONE_BASE_STATION_M = np.array([0.0, 0.0, 50.0])
LONE_SPEED_MPS = (-20.0, 20.0)
LONE_VIEWS: dict[FrameName, tuple[Region, tuple[float, float], float]] = {
    "panel": (Region((-28.0, 28.0), (-31.0, -27.0), (22.0, 78.0), LONE_SPEED_MPS), (0.65, 0.22), 17.0),
    "paper": (Region((-30.0, 30.0), (-30.0, 30.0), (20.5, 24.5), LONE_SPEED_MPS), (-0.22, 0.65), -17.0),
}
"""Of each frame region, direction cosines and velocity in m/s of a lone scatterer.

The place where it seems to be if signs are wrong, or u and w swapped, lies in the region as well, and
more than two Rayleigh cells away.
"""


@dataclass(frozen=True, eq=False)
class Shot:
    """A scene and how it was observed.

    Attributes
    ----------
    scenario : Scenario
    seen : Observation
        Read-only.
    """

    scenario: Scenario
    seen: Observation

    def observation(self, *, writable: bool = True) -> Observation:
        """Give an observation that nobody has seen before, all arrays its own.

        Parameters
        ----------
        writable : bool
            Whether the arrays may be written to: an estimator that does is
            found out by what has changed.
        """
        gate = dataclasses.replace(self.seen.gate)
        fresh = dataclasses.replace(
            self.seen,
            cells=self.seen.cells.copy(),
            gate=gate,
            base_station_m=self.seen.base_station_m.copy(),
        )
        for array in (fresh.cells, fresh.base_station_m, gate.range_bins, gate.doppler_bins):
            array.setflags(write=writable)
        return fresh

    @cached_property
    def n_reachable(self) -> int:
        """Range-Doppler cells that a scatterer of the region can peak in."""
        return int(self.seen.gate.reachable.sum())


@cache
def ordinary(*, paper_frame: bool = False) -> Shot:
    """Three scatterers seen by 6 x 6 elements."""
    return _shot(THREE, frame=PaperFrame() if paper_frame else PanelFrame())


@cache
def other() -> Shot:
    """Give another observation of the shape of `ordinary`: other places, and noise ten times as strong."""
    return _shot([(x, y, z, -v) for y, x, z, v in THREE], snr_db=SNR_DB - 10, trial=1)


@cache
def lone(frame: FrameName = "panel") -> Shot:
    """One scatterer far above the noise, in a region in which its mirror images lie as well."""
    region, (u, w), velocity_mps = LONE_VIEWS[frame]
    [offset_m] = get_frame(frame).offsets([LONE_RANGE_M], [u], [w])
    return _shot(
        [(*(LONE_BASE_STATION_M + offset_m), velocity_mps)],
        array=LONE_ARRAY,
        region=region,
        frame=get_frame(frame),
        base_station_m=LONE_BASE_STATION_M,
        snr_db=LONE_SNR_DB,
    )


@cache
def arrays() -> tuple[Shot, ...]:
    """`ordinary` seen by 2 x 2, 3 x 7 and 7 x 3 elements."""
    return tuple(_shot(THREE, array=shape) for shape in ((2, 2), (3, 7), (7, 3)))


@cache
def noise() -> Shot:
    """Noise alone."""
    return _shot(())


@cache
def silence() -> Shot:
    """Nothing, not even noise."""
    shot = noise()
    return dataclasses.replace(
        shot, seen=dataclasses.replace(shot.seen, cells=np.zeros_like(shot.seen.cells))
    )


@cache
def minimal() -> Shot:
    """One scatterer in a region of one reachable cell: the smallest gate there is, margins around it."""
    return _shot([(10.02, 10.02, 3.02, 0.0)], region=SPECK)


@cache
def single_cell() -> Shot:
    """`minimal` without its margins: one range-Doppler cell."""
    shot, gate = minimal(), minimal().seen.gate
    along, across = gate.reachable_range, gate.reachable_doppler
    bare = dataclasses.replace(
        gate,
        range_bins=gate.range_bins[along],
        doppler_bins=gate.doppler_bins[across],
        reachable_range=slice(0, 1),
        reachable_doppler=slice(0, 1),
    )
    return Shot(
        shot.scenario, dataclasses.replace(shot.seen, cells=shot.seen.cells[along, across].copy(), gate=bare)
    )


def _shot(
    points: object,
    *,
    array: tuple[int, int] = ARRAY,
    region: Region = REGION,
    frame: Frame | None = None,
    base_station_m: NDArray[np.float64] = BASE_STATION_M,
    snr_db: float = SNR_DB,
    trial: int = 0,
) -> Shot:
    """Observe unit scatterers, given as x, y, z and v."""
    places = np.asarray(points, dtype=np.float64).reshape(-1, 4)
    scenario = Scenario(
        name="conformance",
        system=SYSTEM,
        array=VirtualArray((1, 1), array, 1, 1),
        frame=PanelFrame() if frame is None else frame,
        base_station_m=base_station_m,
        region=region,
        scatterers=Scatterers(places[:, :3], places[:, 3], np.ones(len(places))),
    )
    return Shot(scenario, Simulator(scenario).observe(snr_db, trial))
