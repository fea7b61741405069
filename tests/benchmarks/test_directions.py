"""What the directions of all detected cells cost, step by step."""

import numpy as np
from isacbench_algorithms.chain import CellSnapshots, Levels
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.music2d import Music2d
from isacbench_algorithms.music2d_joint import Music2dJoint

from isacbench.dsp.angles.esprit import unitary_esprit
from isacbench.dsp.angles.line_subspaces import music_null_minima, music_null_spectrum, smoothed_covariance
from isacbench.dsp.angles.peaks import line_peaks, plane_maxima, plane_peaks
from isacbench.dsp.angles.planar_subspaces import (
    leading_eigenpairs,
    null_minima,
    planar_covariance,
    planar_null_spectrum,
)
from isacbench.dsp.angles.plane_waves import PlaneWaves
from isacbench.dsp.fitting.maximum_likelihood import resolve_directions


def test_covariance(benchmark, scene):
    found = benchmark(smoothed_covariance, scene.snapshots, scene.n_subarray)
    assert found.shape[1:] == (scene.n_subarray, scene.n_subarray)


def test_eigendecomposition(benchmark, scene):
    assert (benchmark(np.linalg.eigh, scene.covariance)[0][:, -1] > 0).all()


def test_music_spectrum(benchmark, scene):
    vectors, order = scene.subspace
    assert benchmark(music_null_spectrum, vectors, order, scene.steering[1]).min() < 1


def test_spectrum_detector(benchmark, scene):
    spectra = scene.n_subarray / np.maximum(scene.null, 1e-12)
    assert benchmark(Music2d().spectrum_detector.detect, spectra).mask.any()


def test_line_peaks(benchmark, scene):
    assert benchmark(line_peaks, -scene.null, scene.steering[0], scene.subspace[1]).found.any()


def test_peaks_by_newton(benchmark, scene):
    vectors, order = scene.subspace
    step = scene.steering[0][1] - scene.steering[0][0]
    moved = benchmark(music_null_minima, vectors, order, scene.peaks.place, scene.peaks.found, step)
    assert np.abs(moved - scene.peaks.place).max() <= step


def test_pairing(benchmark, scene):
    assert benchmark(scene.paired).found.any(axis=1).mean() > 0.5


def angle_power(scene):
    """Angular power spectra of an FFT of 48 points an axis."""
    spectra = np.fft.ifft2(scene.snapshots, (48, 48), norm="forward")
    return spectra.real**2 + spectra.imag**2


def test_angle_fft(benchmark, scene):
    estimator, levels = Fft4d(), Levels(0.0, 0.0, 0.0)
    cells = CellSnapshots(estimator.readings()[0], None, None, scene.snapshots[:, None], levels)
    waves = benchmark(estimator.plane_waves, scene.observation, cells)
    assert waves.found.any(axis=1).mean() > 0.5


def test_plane_peaks(benchmark, scene):
    power = angle_power(scene)
    peaks = plane_maxima(power) & (power > 0.1 * power.max(axis=(1, 2), keepdims=True))
    assert benchmark(plane_peaks, power, peaks, 6)[2].any(axis=1).all()


def test_planar_covariance(benchmark, scene):
    assert benchmark(planar_covariance, scene.snapshots, scene.subarray).ndim == 3


def test_leading_eigenpairs(benchmark, scene):
    assert (benchmark(leading_eigenpairs, scene.planar_covariance, 2)[0] > 0).all()


def joint_grid(scene):
    """Samples of the joint spectrum over the directions of the region."""
    points = [
        round(np.ptp(limits) * n * Music2dJoint().samples_per_lobe / 4) + 3
        for limits, n in zip(scene.observation.cosine_limits, scene.subarray, strict=True)
    ]
    return [
        np.linspace(*limits, n) for limits, n in zip(scene.observation.cosine_limits, points, strict=True)
    ]


def test_joint_spectrum(benchmark, scene):
    found = benchmark(planar_null_spectrum, scene.planar_basis, *joint_grid(scene))
    assert len(found) == len(scene.snapshots)


def test_joint_peaks(benchmark, scene):
    n_minima = np.full(len(scene.snapshots), 2)
    found = benchmark(null_minima, scene.planar_basis, *joint_grid(scene), n_minima)
    assert found.found.any(axis=1).mean() > 0.5


def test_esprit(benchmark, scene):
    assert benchmark(unitary_esprit, scene.planar_basis).reliable.any()


def test_maximum_likelihood(benchmark, scene):
    found = unitary_esprit(scene.planar_basis)
    waves = PlaneWaves(found.u, found.w, np.ones(found.u.shape, dtype=bool)).select(found.reliable)
    snapshots = scene.snapshots[found.reliable][:, None]
    resolved = benchmark(resolve_directions, snapshots, waves, scene.white, 1e-5, 10)
    assert resolved.found.any()
