"""Single precision: where it flows, what it leaves as it is, and that points stay where they are."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from isacbench_algorithms.chain import PrecisionStage
from isacbench_algorithms.esprit2d import Esprit2d
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.music2d import Music2d
from isacbench_algorithms.music2d_joint import Music2dJoint

from tests.algorithms.scenes import XYZ, simulator

ALL = pytest.mark.parametrize("estimator", [Music2d, Fft4d, Esprit2d, Music2dJoint])
STAGES: tuple[PrecisionStage, ...] = ("detection", "directions", "subspace", "selection")


@cache
def observation():
    """Few scatterers in front of a panel, 30 dB."""
    return simulator().observe(30.0)


def rows(cloud):
    """Points sorted by y."""
    return cloud.to_array()[np.argsort(cloud.xyz[:, 1])]


@ALL
def test_in_double_cells_of_single_precision_are_what_they_are(estimator):
    rounded = observation().cells.astype(np.complex64)
    both = (replace(observation(), cells=cells) for cells in (rounded, rounded.astype(np.complex128)))
    clouds = [estimator(precision="double").estimate(one) for one in both]
    assert len(clouds[0]) == len(XYZ)
    np.testing.assert_array_equal(*(cloud.to_array() for cloud in clouds))


@ALL
def test_stages_have_the_precision_they_declare_and_single_moves_no_point_by_more_than_a_millimetre(
    estimator, monkeypatch
):
    seen, clouds = {}, []
    plane_waves = estimator.plane_waves

    def spied(self, observed, cells):
        seen["directions"] = cells.snapshots.dtype
        return plane_waves(self, observed, cells)

    monkeypatch.setattr(estimator, "plane_waves", spied)
    for precision in ("single", "double"):
        one = estimator(precision=precision)
        clouds.append(rows(one.estimate(observation())))
        assert seen["directions"] == one.dtype_in("directions")
        for stage in STAGES:
            single = precision == "single" and stage in estimator.single_stages
            assert one.dtype_in(stage) == (np.complex64 if single else np.complex128)
    assert len(clouds[0]) == len(clouds[1]) == len(XYZ)
    # A test of the map that passes the same cells changes nothing after it.
    assert np.any(clouds[0] != clouds[1]) == bool(estimator.single_stages - {"detection"})
    np.testing.assert_allclose(clouds[0], clouds[1], atol=1e-3)


@pytest.mark.parametrize(
    ("estimator", "precision"),
    [(Music2d, "single"), (Fft4d, "single"), (Esprit2d, "double"), (Music2dJoint, "double")],
)
def test_the_default_is_single_where_no_curve_feels_it(estimator, precision):
    assert estimator().precision == precision
    # Eigenvectors in single precision move curves by per cents.
    assert "subspace" not in estimator.single_stages
