"""The chain of a cell-by-cell estimator: each of its stages is exchanged by itself."""

import re
import sys
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from isacbench_algorithms.bartlett2d import Bartlett2d
from isacbench_algorithms.capon2d import Capon2d
from isacbench_algorithms.detectors import CaCfar
from isacbench_algorithms.esprit2d import Esprit2d
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.iaa2d import Iaa2d
from isacbench_algorithms.music2d import Music2d
from isacbench_algorithms.music2d_joint import Music2dJoint

from isacbench import PointCloud
from isacbench.dsp.angles.plane_waves import PlaneWaves
from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator
from isacbench.model.frame import get_frame
from isacbench.model.numerology import System
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers, Scenario

CELLWISE = [Fft4d, Music2d, Music2dJoint, Esprit2d, Bartlett2d, Capon2d, Iaa2d]
ALL = pytest.mark.parametrize("estimator", CELLWISE, ids=lambda e: e.name)
# One of those that share plane waves or spectra.
EXCHANGED = pytest.mark.parametrize("estimator", [Fft4d, Music2d, Esprit2d, Capon2d], ids=lambda e: e.name)
DOCUMENT = Path(__file__).parents[2] / "docs" / "chain.md"


def simulator(n_scatterers):
    """Simulator of scatterers at random in front of an 8 x 8 array, of three speeds."""
    rng = np.random.default_rng(0)
    region = Region((0.0, 20.0), (0.0, 25.0), (0.0, 8.0), (-15.0, 15.0))
    xyz = region.lower_m + region.size_m * rng.random((n_scatterers, 3))
    return Simulator(
        Scenario(
            name="crowd",
            system=System(n_subcarriers=256, n_symbols=56),
            array=VirtualArray((2, 2), (4, 4), 4, 1),
            frame=get_frame("panel"),
            base_station_m=np.array([10.0, 60.0, 15.0]),
            region=region,
            scatterers=Scatterers(xyz, rng.choice([-10.0, 0.0, 10.0], n_scatterers), np.ones(n_scatterers)),
        )
    )


@cache
def crowd():
    """A crowd of 60, many to a cell, 10 dB."""
    return simulator(60).observe(10.0)


@cache
def image(estimator, **params):
    """Cloud of the crowd."""
    return estimator(**params).estimate(crowd())


@cache
def diagnosis(estimator, **params):
    """Diagnosis of the crowd."""
    return estimator(**params).diagnose(crowd())


@ALL
def test_the_detector_is_exchanged_by_an_argument(estimator):
    few = diagnosis(estimator, detector=CaCfar(pfa=1e-9)).detection.mask
    assert 0 < few.sum() < diagnosis(estimator).detection.mask.sum()


@ALL
def test_plane_waves_are_exchanged_by_one_method(estimator):
    class Ahead(estimator):
        def plane_waves(self, observation, cells):
            u, w = (np.full((len(cells), 1), np.mean(limits)) for limits in observation.cosine_limits)
            return PlaneWaves(u, w, np.ones(u.shape, dtype=bool))

    cloud = Ahead().estimate(crowd())
    assert len(cloud)
    u, w = crowd().frame.direction_cosines(cloud.xyz - crowd().base_station_m)
    middle = np.mean(crowd().cosine_limits, axis=1)
    np.testing.assert_allclose(np.stack([u, w], axis=1), np.tile(middle, (len(cloud), 1)), atol=1e-9)


@EXCHANGED
def test_the_own_cell_test_the_sidelobe_test_and_the_cloud_are_exchanged_by_one_method_each(estimator):
    class Everywhere(estimator):
        def own_cell_test(self, located):
            return located

    class Untested(Everywhere):
        def sidelobe_test(self, located, rdm, levels):
            return located.scatterers

    class Nothing(estimator):
        def to_cloud(self, rdm, found):
            return PointCloud.empty()

    # With weak waves, some of which are those of a neighbouring cell.
    given = {"local_dynamic_range_db": 30.0}
    tested, anywhere, untested = (
        len(one(**given).estimate(crowd())) for one in (estimator, Everywhere, Untested)
    )
    assert 0 < tested < anywhere < untested
    assert len(Nothing().estimate(crowd())) == 0


@ALL
def test_no_two_points_are_one_scatterer(estimator):
    observation, cloud = crowd(), image(estimator)
    u, w = observation.frame.direction_cosines(cloud.xyz - observation.base_station_m)
    range_m = np.linalg.norm(cloud.xyz - observation.base_station_m, axis=1)
    system = observation.system
    points = np.column_stack(
        [range_m / system.range_bin_m, cloud.velocity / system.velocity_bin_mps, u, w]
    ) / [0.3, 0.3, 0.01, 0.01]
    apart = np.abs(points[:, None] - points).max(axis=2)
    assert apart[np.triu_indices(len(cloud), 1)].min() > 1 - 1e-9


@ALL
def test_the_map_of_the_detection_is_tapered_as_asked_for(estimator):
    # Sidelobes are what a taper is for: without it the weakest cells of a crowd are stronger.
    plain = diagnosis(estimator, detection_window="rect")
    assert np.median(plain.power) > np.median(diagnosis(estimator).power)
    assert estimator().detection_window == "hann"


def test_the_examples_of_the_documentation_run(monkeypatch):
    script = ModuleType("script")
    monkeypatch.setitem(sys.modules, "script", script)
    examples = re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert examples
    for example in examples:
        exec(example, vars(script))
    assert len(script.cloud)
