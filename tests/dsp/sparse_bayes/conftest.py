"""What tests of sparse Bayesian learning share: a small radio, and maps of known atoms."""

from dataclasses import replace

import numpy as np
import pytest

from isacbench.dsp.fitting.atoms import AtomMap
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.dsp.sparse_bayes.places import Reach
from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator
from isacbench.model.frame import get_frame
from isacbench.model.numerology import System
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers, Scenario

SCENARIO = Scenario(
    name="small",
    system=System(n_subcarriers=255, n_symbols=63),
    array=VirtualArray((1, 1), (8, 8), 1, 1),
    frame=get_frame("panel"),
    base_station_m=np.array([0.0, 60.0, 12.0]),
    region=Region((-15.0, 15.0), (0.0, 20.0), (-5.0, 15.0), (-25.0, 25.0)),
    scatterers=Scatterers(np.empty((0, 3)), np.empty(0), np.empty(0)),
)
NOISE = 1e-6


@pytest.fixture
def rng():
    return np.random.default_rng(4)


@pytest.fixture(scope="session")
def reach_and_map():
    """Reach of a small radio, and its map without echoes."""
    observation = Simulator(SCENARIO).observe(10.0)
    gated = GatedMap.of(observation, np.zeros_like(observation.cells))
    atom_map = AtomMap.from_map(gated, observation.system, observation.cosine_limits)
    return Reach.of(observation, atom_map), atom_map


@pytest.fixture
def noisy_map(reach_and_map, rng):
    """Make a map of atoms at places, and noise of power `NOISE`."""
    _, empty = reach_and_map

    def make(places, amplitude):
        parts = rng.standard_normal((2, *empty.cells.shape)) * np.sqrt(NOISE / 2)
        noise = replace(empty, cells=parts[0] + 1j * parts[1])
        return noise.without(noise.lines(places), -np.asarray(amplitude, dtype=np.complex128))

    return make


@pytest.fixture
def middle(reach_and_map):
    """A place in the middle of the region, in Rayleigh cells."""
    reach, _ = reach_and_map
    (least_u, most_u), (least_w, most_w) = reach.direction_limits
    return np.array([np.mean(reach.range_limits), 0.0, (least_u + most_u) / 2, (least_w + most_w) / 2]).round(
        1
    )
