"""What tests of sparse Bayesian learning share: a small radio, and maps of known atoms."""

from dataclasses import replace

import numpy as np
import pytest

from isacbench.dsp.fitting.atoms import AtomMap
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.dsp.sparse_bayes.places import Reach
from isacbench.model.echo import Simulator
from isacbench.model.region import Region
from tests.algorithms.scenes import EMPTY
from tests.dsp.plane_wave_data import noise as white

SCENARIO = replace(
    EMPTY,
    base_station_m=np.array([0.0, 60.0, 12.0]),
    region=Region((-15.0, 15.0), (0.0, 20.0), (-5.0, 15.0), (-25.0, 25.0)),
)
NOISE = 1e-6


@pytest.fixture
def rng():
    return np.random.default_rng(4)


@pytest.fixture(scope="session")
def silence():
    """Observation of a small radio, and its map without echoes."""
    observation = Simulator(SCENARIO).observe(10.0)
    gated = GatedMap.of(observation, np.zeros_like(observation.cells))
    return observation, AtomMap.from_map(gated, observation.system, observation.cosine_limits)


@pytest.fixture(scope="session")
def reach(silence):
    return Reach(*silence)


@pytest.fixture
def noisy_map(silence, rng):
    """Make a map of atoms at places, and noise of power `NOISE`."""
    _, empty = silence

    def make(places, amplitude):
        noise = replace(empty, cells=np.sqrt(NOISE) * white(*empty.cells.shape, seed=rng))
        return noise.without(noise.lines(places), -np.asarray(amplitude, dtype=np.complex128))

    return make


@pytest.fixture
def middle(reach):
    """A place in the middle of the region, in Rayleigh cells."""
    return np.array([np.mean(reach.range_limits), 0.0, *np.mean(reach.direction_limits, axis=1)]).round(1)
