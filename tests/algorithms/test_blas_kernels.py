"""Images of whole streets under every BLAS kernel that the processor can run."""

import pytest

from isacbench import get_estimator, load_scenario, observe
from isacbench.checking.promises.blas_kernels import KernelProcess, other_kernels
from isacbench.checking.promises.drift import cloud_drift

BOUND = 1e-7
"""Relative, see `cloud_drift`: a street is a crowd of scatterers, where no promise of 1e-9 is made."""


NAMES = (
    *("fft4d", "music2d", "esprit2d", "music2d_joint", "nomp4d", "sbl4d"),
    *("bartlett2d", "capon2d", "iaa2d", "omp4d"),
)


@pytest.mark.slow
@pytest.mark.parametrize("snr_db", [-20, 10])
@pytest.mark.parametrize("scene", ["street", "street-paper", "street-coherent"])
def test_the_image_of_a_street_does_not_depend_on_the_blas_kernel(scene, snr_db):
    scenario = load_scenario(scene)
    observation = observe(scenario, snr_db)
    drifts = {}
    for kernel, core_type in other_kernels().items():
        process = KernelProcess(core_type)
        for name in NAMES:
            estimator = get_estimator(name)
            there = process.image(estimator, observation, scenario.truth)
            drifts[kernel, name] = cloud_drift(scenario, estimator.estimate(observation), there)
        process.close()
    print(scene, snr_db, {" ".join(key): f"{drift:.1e}" for key, drift in drifts.items()})
    assert max(drifts.values(), default=0.0) < BOUND
