"""Images of a frame at full size against the plain chain, which transforms all that there is.

The plain chain is what one writes first: both FFTs on every element with two
threads of `scipy.fft`, the power of the whole map averaged over the array, and
then the same detection and angles. Ratios are printed and kept in the
benchmark's ``extra_info``; they decide nothing.
"""

import numpy as np
import pytest
import scipy.fft
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.music2d import Music2d

from isacbench import load_scenario, observe_cube
from isacbench.cubes.writing import FrameSimulator
from isacbench.model.gate import build_gate
from isacbench.model.observation import Observation

N_THREADS = 2
ROUNDS = 5

pytestmark = pytest.mark.benchmark(group="cube")


@pytest.fixture(scope="module")
def street():
    """Return the street at the paper's size."""
    return load_scenario("street")


@pytest.fixture(scope="module")
def frame(street):
    """Return its frame at 10 dB, complex64, subcarriers outermost."""
    return np.concatenate([block.astype(np.complex64) for block in FrameSimulator(street, 10.0).blocks()])


@pytest.fixture(scope="module", params=["subcarriers outermost", "elements outermost"])
def cube(request, frame):
    """Return the frame in either memory order."""
    if request.param == "subcarriers outermost":
        return frame
    return np.ascontiguousarray(frame.transpose(2, 3, 1, 0)).transpose(3, 2, 0, 1)


def plain_chain(cube, scenario, estimator):
    """Image by whole transforms on every element."""
    ranges = scipy.fft.ifft(cube, axis=0, norm="ortho", workers=N_THREADS)
    cells = scipy.fft.fft(ranges, axis=1, norm="ortho", workers=N_THREADS, overwrite_x=True)
    power = np.mean(cells.real**2 + cells.imag**2, axis=(2, 3))
    assert power.shape == cube.shape[:2]
    gate = build_gate(scenario.system, scenario.base_station_m, scenario.region)
    rows = np.ix_(gate.range_bins % cube.shape[0], gate.doppler_bins % cube.shape[1])
    radio = scenario.system, scenario.array, scenario.frame, scenario.base_station_m, scenario.region
    return estimator.estimate(Observation(cells[rows], gate, *radio))


@pytest.mark.parametrize("integration", ["noncoherent", "element"])
@pytest.mark.parametrize("estimator", [Music2d, Fft4d], ids=lambda one: one.name)
def test_image_of_a_cube_against_the_plain_chain(against, street, cube, estimator, integration):
    imager = estimator(integration=integration)
    cloud = against(
        lambda: imager.estimate(observe_cube(cube, street, workers=N_THREADS)),
        {
            "the plain chain": lambda: plain_chain(cube, street, imager),
            "its FFT along range": lambda: scipy.fft.ifft(cube, axis=0, norm="ortho", workers=N_THREADS),
        },
        rounds=ROUNDS,
    )
    assert len(cloud) > 20
