"""Simulated frames: white noise everywhere, and in the gate the very observation of the closed form."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from isacbench_algorithms.music2d import Music2d

from isacbench import observe, observe_cube
from isacbench.cubes.writing import FrameSimulator, write_cube
from isacbench.dsp.rangedoppler import range_doppler_map
from isacbench.model.array import VirtualArray
from tests.conftest import few
from tests.gated_cells import gate_of


def frame_of(scenario, *which):
    """Blocks of a frame, put together."""
    frame = FrameSimulator(scenario, *which)
    return np.concatenate([*frame.blocks()])


def test_the_frame_transforms_into_the_observation_of_the_same_trial_with_the_errors_of_the_elements(
    small_street,
):
    erring = replace(small_street, gain_error_db=0.5, phase_error_deg=5.0)
    cells = observe_cube(frame_of(erring, 10.0, 2, 5), small_street).cells
    expected, perfect = (observe(one, 10.0, trial=2, seed=5).cells for one in (erring, small_street))
    scale = np.abs(expected).max()
    np.testing.assert_allclose(cells, expected, atol=1e-11 * scale)
    assert np.abs(cells - perfect).max() > 1e-2 * scale


def test_a_frame_with_noise_of_the_transmitter_transforms_into_the_observation(small_street):
    noisy = replace(small_street, system=replace(small_street.system, noise="transmitter"))
    expected = observe(noisy, -20.0, trial=2, seed=5).cells
    cells = observe_cube(frame_of(noisy, -20.0, 2, 5), small_street).cells
    np.testing.assert_allclose(cells, expected, atol=1e-11 * np.abs(expected).max())


def test_noise_outside_the_gate_is_as_white_as_inside(small_street, clean_cube):
    frame = frame_of(small_street, 0.0, 1, 0)
    noise_power = np.sum(small_street.scatterers.amplitude**2)
    cells = range_doppler_map(frame - clean_cube) / np.sqrt(noise_power)
    gate = gate_of(small_street)
    outside = np.ones(cells.shape[:2], dtype=bool)
    outside[np.ix_(gate.range_bins % 512, gate.doppler_bins % 56)] = False
    for part in (cells[outside], cells[~outside]):
        power = np.abs(part) ** 2
        # Five standard deviations of a mean of unit exponentials, and of products of neighbours.
        assert abs(power.mean() - 1) < 5 / np.sqrt(power.size)
        assert abs(np.mean(part[1:] * part[:-1].conj())) < 5 / np.sqrt(part[1:].size)
        assert abs(np.mean(part[..., 1:] * part[..., :-1].conj())) < 5 / np.sqrt(part[..., 1:].size)


def test_trials_and_seeds_have_noise_of_their_own(small_street):
    simulators = [FrameSimulator(small_street, 0.0, *which) for which in ((0, 0), (1, 0), (0, 1), (0, 0))]
    first, *others, again = (next(iter(simulator.blocks())).tobytes() for simulator in simulators)
    assert len({first, *others}) == 3
    assert again == first


def test_the_image_of_a_written_frame_is_that_of_the_observation(small_street, tmp_path):
    path = tmp_path / "frame.npy"
    shown = []
    frame = FrameSimulator(small_street, 10.0, 3)
    write_cube(path, frame.shape, frame.blocks(), np.complex128, lambda *of: shown.append(of))
    assert shown[-1] == (512, 512)
    assert np.load(path, mmap_mode="r").dtype == np.complex128
    cloud = Music2d().estimate(observe_cube(path, small_street))
    expected = Music2d().estimate(observe(small_street, 10.0, trial=3))
    assert len(expected) >= 15
    np.testing.assert_allclose(cloud.to_array(), expected.to_array(), rtol=1e-8, atol=1e-8)


LAYOUTS = {
    "c order": lambda cube: cube,
    "fortran order": np.asfortranarray,
    "element-major": lambda cube: np.ascontiguousarray(cube.transpose(2, 3, 0, 1)).transpose(2, 3, 0, 1),
    "every other": lambda cube: np.repeat(cube, 2, axis=1)[:, ::2],
    "backwards": lambda cube: np.ascontiguousarray(cube[::-1])[::-1],
}


@few
@given(
    n_subcarriers=st.sampled_from([1, 2, 3, 16, 61, 128, 257]),
    n_symbols=st.sampled_from([1, 2, 3, 7, 14, 31]),
    shape=st.sampled_from([(2, 2), (2, 7), (5, 3), (16, 2)]),
    scale=st.sampled_from([1.0, 1e-150, 1e150]),
    snr_db=st.sampled_from([np.inf, 20.0, -20.0]),
    layout=st.sampled_from(sorted(LAYOUTS)),
)
def test_frames_of_any_size_level_and_layout_transform_into_the_observation(
    small_street, n_subcarriers, n_symbols, shape, scale, snr_db, layout
):
    system = replace(small_street.system, n_subcarriers=n_subcarriers, n_symbols=n_symbols)
    scatterers = replace(small_street.scatterers, amplitude=scale * small_street.scatterers.amplitude)
    array = VirtualArray((1, 1), shape)
    scenario = replace(small_street, system=system, array=array, scatterers=scatterers)
    expected = observe(scenario, snr_db, trial=1)
    seen = observe_cube(LAYOUTS[layout](frame_of(scenario, snr_db, 1)), scenario)
    bound = 1e-11 * np.abs(expected.cells).max()
    np.testing.assert_allclose(seen.cross, expected.cross, rtol=0, atol=bound)
    np.testing.assert_allclose(seen.cells, expected.cells, rtol=0, atol=bound)
