"""What every stage of an observation and of an image costs."""

from itertools import count

import numpy as np
import pytest
from isacbench_algorithms.chain import CellSnapshots, Levels
from isacbench_algorithms.detectors import CaCfar, GocaCfar, OscaCfar, OsCfar, SocaCfar, TmCfar
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.music2d import Music2d
from isacbench_algorithms.music2d_joint import Music2dJoint
from isacbench_algorithms.nomp4d import Nomp4d

from isacbench.dsp.angles.line_subspaces import music_null_minima, music_null_spectrum, smoothed_covariance
from isacbench.dsp.angles.peaks import line_peaks, plane_maxima, plane_peaks
from isacbench.dsp.angles.planar_subspaces import (
    leading_eigenpairs,
    null_minima,
    planar_covariance,
    planar_null_spectrum,
    unitary_esprit,
)
from isacbench.dsp.angles.plane_waves import PlaneWaves
from isacbench.dsp.cell_detection import detect_cells, power_map, white_noise
from isacbench.dsp.cfar.trimmed_factors import tm_factor
from isacbench.dsp.fitting.atom_fits import fit_atoms, refine_atoms
from isacbench.dsp.fitting.joint_selection import explain_map
from isacbench.dsp.fitting.maximum_likelihood import resolve_directions
from isacbench.dsp.fitting.pursuit import BeamSpace
from isacbench.model.echo import clean_echo, unit_noise

DETECTORS = [CaCfar(), OsCfar(), OscaCfar(), GocaCfar(), SocaCfar(), TmCfar()]


def another_trial(one):
    trials = count(1)
    return (lambda: one.simulator.observe(10.0, next(trials)),)


def newton(one):
    step = one.steering[0][1] - one.steering[0][0]
    return music_null_minima, *one.subspace, one.peaks.place, one.peaks.found, step


def angle_fft(one):
    estimator, levels = Fft4d(), Levels(0.0, 0.0, 0.0)
    cells = CellSnapshots(estimator.readings()[0], None, None, one.snapshots[:, None], levels)
    return estimator.plane_waves, one.observation, cells


def peaks_of_planes(one):
    spectra = np.fft.ifft2(one.snapshots, (48, 48), norm="forward")
    power = spectra.real**2 + spectra.imag**2
    peaks = plane_maxima(power) & (power > 0.1 * power.max(axis=(1, 2), keepdims=True))
    return plane_peaks, power, peaks, 6


def joint_grid(one):
    """Samples of the joint spectrum over the directions of the region."""
    limits, lobe = one.observation.cosine_limits, Music2dJoint().samples_per_lobe
    points = [round(np.ptp(ends) * n * lobe / 4) + 3 for ends, n in zip(limits, one.subarray, strict=True)]
    return [np.linspace(*ends, n) for ends, n in zip(limits, points, strict=True)]


def maximum_likelihood(one):
    found = unitary_esprit(one.planar_basis)
    waves = PlaneWaves(found.u, found.w, np.ones(found.u.shape, dtype=bool)).select(found.reliable)
    return resolve_directions, one.snapshots[found.reliable][:, None], waves, one.white, 1e-5, 10


def atom_peaks(one):
    space = BeamSpace.from_map(one.atom_map, one.simulator.gate, one.observation.cosine_limits)
    level = one.white * np.log(space.n_independent / 1e-2)
    return (lambda: space.peaks(space.residual(None), level),)


STAGES = {
    "clean echo": lambda one: (clean_echo, one.scenario, one.simulator.gate),
    "noise": lambda one: (unit_noise, one.scenario.name, 0, 0, one.simulator.clean.shape),
    "observe at another SNR": lambda one: (one.simulator.observe, 10.0),
    "observe another trial": another_trial,
    **{
        f"taper {window}": lambda one, window=window: (one.gated.tapered, window, window)
        for window in ("soft", "hann", "blackman")
    },
    **{
        f"power map {integration}": lambda one, integration=integration: (
            *(power_map, one.seen.cells),
            integration,
        )
        for integration in ("element", "noncoherent")
    },
    "white noise": lambda one: (white_noise, one.gated),
    **{
        f"detect {detector.name}": lambda one, detector=detector: (
            *(detect_cells, one.seen),
            *(detector, "noncoherent", 28.0),
        )
        for detector in DETECTORS
    },
    "covariance": lambda one: (smoothed_covariance, one.snapshots, one.n_subarray),
    "eigendecomposition": lambda one: (np.linalg.eigh, one.covariance),
    "MUSIC spectrum": lambda one: (music_null_spectrum, *one.subspace, one.steering[1]),
    "spectrum detector": lambda one: (
        *(Music2d().spectrum_detector.detect, one.n_subarray / np.maximum(one.null, 1e-12)),
    ),
    "line peaks": lambda one: (line_peaks, -one.null, one.steering[0], one.subspace[1]),
    "peaks by Newton": newton,
    "pairing": lambda one: (one.paired,),
    "angle FFT": angle_fft,
    "plane peaks": peaks_of_planes,
    "planar covariance": lambda one: (planar_covariance, one.snapshots, one.subarray),
    "leading eigenpairs": lambda one: (leading_eigenpairs, one.planar_covariance, 2),
    "joint spectrum": lambda one: (planar_null_spectrum, one.planar_basis, *joint_grid(one)),
    "joint peaks": lambda one: (
        *(null_minima, one.planar_basis, *joint_grid(one)),
        np.full(len(one.snapshots), 2),
    ),
    "ESPRIT": lambda one: (unitary_esprit, one.planar_basis),
    "maximum likelihood": maximum_likelihood,
    "locate": lambda one: (one.located,),
    "select jointly": lambda one: (one.selected,),
    "explain map": lambda one: (
        *(explain_map, one.thin.chosen, one.thin.gated),
        *(one.thin.scenario.system, one.thin.white),
    ),
    "atom map": lambda one: (one.new_atom_map,),
    "atom peaks": atom_peaks,
    "atom fit": lambda one: (fit_atoms, one.atom_map, one.places),
    **{
        f"atom refinement {n_steps}": lambda one, n_steps=n_steps: (
            *(refine_atoms, one.atom_map, one.places),
            n_steps,
        )
        for n_steps in (1, 4)
    },
    "round of matching pursuit": lambda one: (Nomp4d(max_rounds=1).estimate, one.observation),
}


@pytest.mark.parametrize("stage", STAGES)
def test_stage(benchmark, scene, stage):
    assert benchmark(*STAGES[stage](scene)) is not None


@pytest.mark.parametrize("detector", DETECTORS, ids=lambda detector: detector.name)
@pytest.mark.parametrize("n_cells", [100, 1000, 10_000, None])
def test_detect_on_a_whole_map(benchmark, detector, n_cells):
    power, rng = np.random.default_rng(0).standard_exponential((224, 2048)), np.random.default_rng(1)
    cells = n_cells and tuple(rng.integers(0, length, n_cells) for length in power.shape)
    found = benchmark(lambda: detector.detect(power, cells=cells).threshold)
    assert found.size == (n_cells or power.size)


@pytest.mark.parametrize("looks", [2, 16, 256])
def test_factor_of_a_trimmed_mean(benchmark, looks):
    assert benchmark(tm_factor.__wrapped__, 1e-3, 72, (18, 18), looks) > 1
