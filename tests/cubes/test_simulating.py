"""Simulated frames: white noise everywhere, and in the gate the very observation of the closed form."""

import numpy as np
import pytest
from isacbench_algorithms.music2d import Music2d

from isacbench import observe, observe_cube
from isacbench.cubes.simulating import FrameSimulator, write_frame
from isacbench.dsp.rangedoppler import range_doppler_map
from isacbench.model.gate import build_gate


def frame_of(scenario, *which):
    """Blocks of a frame, put together."""
    frame = FrameSimulator(scenario, *which)
    return np.concatenate([block for _, block in frame.blocks()])


@pytest.mark.parametrize("snr_db", [np.inf, 10.0, -20.0])
def test_the_frame_transforms_into_the_observation_of_the_same_trial(small_street, snr_db):
    cells = observe_cube(frame_of(small_street, snr_db, 2, 5), small_street).cells
    expected = observe(small_street, snr_db, trial=2, seed=5).cells
    np.testing.assert_allclose(cells, expected, atol=1e-11 * np.abs(expected).max())


def test_noise_outside_the_gate_is_as_white_as_inside(small_street, clean_cube):
    frame = frame_of(small_street, 0.0, 1, 0)
    noise_power = np.sum(small_street.scatterers.amplitude**2)
    cells = range_doppler_map(frame - clean_cube) / np.sqrt(noise_power)
    gate = build_gate(small_street.system, small_street.base_station_m, small_street.region)
    outside = np.ones(cells.shape[:2], dtype=bool)
    outside[np.ix_(gate.range_bins % 512, gate.doppler_bins % 56)] = False
    for part in (cells[outside], cells[~outside]):
        power = np.abs(part) ** 2
        # Five standard deviations of a mean of unit exponentials, and of products of neighbours.
        assert abs(power.mean() - 1) < 5 / np.sqrt(power.size)
        assert abs(np.mean(part[1:] * part[:-1].conj())) < 5 / np.sqrt(part[1:].size)
        assert abs(np.mean(part[..., 1:] * part[..., :-1].conj())) < 5 / np.sqrt(part[..., 1:].size)


def test_trials_and_seeds_have_noise_of_their_own(small_street):
    frames = [frame_of(small_street, 0.0, *which)[:32] for which in ((0, 0), (1, 0), (0, 1))]
    assert len({block.tobytes() for block in frames}) == 3
    assert np.array_equal(frames[0], frame_of(small_street, 0.0, 0, 0)[:32])


@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
def test_the_image_of_a_written_frame_is_that_of_the_observation(small_street, tmp_path, dtype):
    path = tmp_path / "frame.npy"
    shown = []
    frame = FrameSimulator(small_street, 10.0, 3)
    write_frame(frame, path, dtype, lambda n_done, n: shown.append((n_done, n)))
    assert shown[-1] == (512, 512)
    assert np.load(path, mmap_mode="r").dtype == dtype
    cloud = Music2d().estimate(observe_cube(path, small_street))
    expected = Music2d().estimate(observe(small_street, 10.0, trial=3))
    assert len(expected) > 20
    np.testing.assert_allclose(cloud.to_array(), expected.to_array(), rtol=2e-6, atol=2e-5)
