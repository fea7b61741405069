"""Scenes of a few scatterers, built in code."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from isacbench.model.array import VirtualArray
from isacbench.model.frame import FrameName, get_frame
from isacbench.model.numerology import System
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers, Scenario

MakeScenario = Callable[..., Scenario]

ARRAY = VirtualArray((2, 2), (2, 2), 2, 1)
XYZ = np.array([[1.3, 2.2, 0.4], [5.1, 6.7, 1.9], [8.8, 9.4, 4.6]])
VELOCITY = np.array([3.7, -11.2, 0.9])
AMPLITUDE = np.array([1.0, 0.6, 2.5])


@pytest.fixture(scope="session")
def make_scenario() -> MakeScenario:
    """Return a function that builds a scene of three scatterers in front of a 4 x 4 array, or of others."""

    def build(
        frame: FrameName = "panel",
        *,
        name: str = "few",
        xyz: Any = XYZ,
        velocity: Any = VELOCITY,
        amplitude: Any = AMPLITUDE,
        phase_rad: Any = 0.0,
        array: VirtualArray = ARRAY,
        **system: Any,
    ) -> Scenario:
        return Scenario(
            name=name,
            system=System(**{"n_subcarriers": 256, "n_symbols": 32, **system}),
            array=array,
            frame=get_frame(frame),
            base_station_m=np.array([5.0, 40.0, 10.0]),
            region=Region((0.0, 10.0), (0.0, 10.0), (0.0, 5.0), (-15.0, 15.0)),
            scatterers=Scatterers(xyz, velocity, amplitude, phase_rad),
        )

    return build
