"""Estimators with an angular spectrum: what all of them share."""

import numpy as np
import pytest
from isacbench_algorithms.bartlett2d import Bartlett2d
from isacbench_algorithms.capon2d import Capon2d
from isacbench_algorithms.esprit2d import Esprit2d
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.iaa2d import Iaa2d
from isacbench_algorithms.music2d import Music2d
from isacbench_algorithms.music2d_joint import Music2dJoint

import isacbench
from isacbench.checking.scenes import RESOLVED, observed

SPECTRA = [Bartlett2d, Capon2d, Iaa2d]
ALL = pytest.mark.parametrize("estimator", SPECTRA, ids=lambda one: one.name)


@pytest.fixture(scope="module")
def street(small_street):
    return isacbench.observe(small_street, snr_db=-25)


@pytest.mark.parametrize(
    "estimator",
    [Bartlett2d, Capon2d, Iaa2d, Fft4d, Music2d, Esprit2d, Music2dJoint],
    ids=lambda one: one.name,
)
def test_noise_is_taken_for_a_plane_wave_no_more_often_than_angle_pfa_says(street, estimator):
    often, hardly = (len(estimator(angle_pfa=pfa).estimate(street)) for pfa in (0.5, 1e-300))
    assert hardly < often


@ALL
def test_a_diagnosis_cuts_the_spectrum_through_its_maximum(street, estimator):
    along_u, along_w = estimator().diagnose(street).spectra
    for cut in (along_u, along_w):
        assert cut.level_db.max() == pytest.approx(0.0)
        assert cut.cosine.shape == cut.level_db.shape
        assert np.all((cut.peaks >= cut.cosine[0]) & (cut.peaks <= cut.cosine[-1]))
    assert (along_u.label, along_w.label) == ("u", "w")


def test_a_diagnosis_marks_the_directions_that_the_image_has(street):
    # Polished ones, which lie between the samples.
    polished, raw = (Iaa2d(polish=polish).diagnose(street).spectra[0].peaks for polish in (3, 0))
    assert not np.array_equal(polished, raw)


def test_maximum_likelihood_brings_the_peaks_of_the_adaptive_approach_nearer_to_the_truth():
    shot = observed(RESOLVED, 10.0)
    off_m = [
        np.linalg.norm(
            Iaa2d(polish=polish).estimate(shot.seen).xyz[:, None] - shot.scenario.truth.xyz, axis=2
        ).min(axis=0)
        for polish in (0, 3)
    ]
    assert np.median(off_m[1]) < 0.2 * np.median(off_m[0])
