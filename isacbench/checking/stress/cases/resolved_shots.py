"""Small scenes whose echoes lie where a case wants them: scatterers given as the radio sees them."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from isacbench.checking.contract.small_scenes import Shot
from isacbench.errors import InputWarning
from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator
from isacbench.model.frame import Frame, PanelFrame
from isacbench.model.numerology import System
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers, Scenario

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

SYSTEM = System(n_subcarriers=256, n_symbols=32)
"""Range bins of 2.4 m, velocity bins of 12.8 m/s."""

BASE_STATION_M = 10.0, 50.0, 12.0

REGION = Region((-25.0, 45.0), (15.0, 50.0), (-23.0, 47.0), (-60.0, 60.0))
"""Everything in front of the base station up to 35 m sideways: all directions are visible."""

NARROW = Region((5.0, 15.0), (25.0, 35.0), (7.0, 17.0), (-20.0, 20.0))
"""Small, so that little is to be transformed and hardly any radio is too coarse for it."""

ARRAY = 8, 8


class Echo(NamedTuple):
    """A scatterer as the radio sees it: bins, direction cosines, amplitude, phase in radians."""

    range_bin: float
    doppler_bin: float
    u: float
    w: float
    amplitude: float = 1.0
    phase_rad: float = 0.0


RESOLVED = (
    Echo(6.3, -2.2, -0.45, 0.31),
    Echo(9.7, 1.4, 0.5, -0.42),
    Echo(12.4, 3.1, 0.1, 0.55),
)
"""Three echoes that nothing has in common."""


class Layout(NamedTuple):
    """The radio and the region that a case observes with."""

    system: System = SYSTEM
    array: tuple[int, int] = ARRAY
    frame: Frame = PanelFrame()
    region: Region = REGION


def scenario_of(echoes: Sequence[Echo], layout: Layout = Layout()) -> Scenario:  # noqa: B008, immutable
    """Scenario of echoes, some of which may lie where no estimator looks.

    Parameters
    ----------
    echoes : sequence of Echo
    layout : Layout

    Returns
    -------
    Scenario
    """
    columns: NDArray[np.float64] = np.array(echoes, dtype=np.float64).reshape(-1, 6)
    range_bin, doppler_bin, u, w, amplitude, phase_rad = columns.T
    system = layout.system
    offset_m = layout.frame.offsets(range_bin * system.range_bin_m, u, w)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)  # strays are on purpose
        return Scenario(
            name="stress",
            system=system,
            array=VirtualArray((1, 1), layout.array, 1, 1),
            frame=layout.frame,
            base_station_m=np.array(BASE_STATION_M),
            region=layout.region,
            scatterers=Scatterers(
                np.array(BASE_STATION_M) + offset_m,
                doppler_bin * system.velocity_bin_mps,
                amplitude,
                phase_rad,
            ),
        )


def observed(
    echoes: Sequence[Echo],
    snr_db: float = np.inf,
    seed: int = 0,
    layout: Layout = Layout(),  # noqa: B008, immutable
) -> Shot:
    """Observe echoes.

    Parameters
    ----------
    echoes : sequence of Echo
    snr_db : float
        Infinity for no noise.
    seed : int
    layout : Layout

    Returns
    -------
    Shot
    """
    scenario = scenario_of(echoes, layout)
    return Shot(scenario, Simulator(scenario).observe(snr_db, seed=seed))


def with_cells(shot: Shot, cells: NDArray[np.complexfloating[Any, Any]]) -> Shot:
    """Shot of the same scene with other cells (n_range, n_doppler, P, Q)."""
    return replace(shot, seen=replace(shot.seen, cells=cells))
