from __future__ import annotations

import numpy as np
import pytest
from isacbench_algorithms.detectors import CaCfar, GocaCfar, OscaCfar, OsCfar, SocaCfar, TmCfar

from isacbench import get_detector
from isacbench.dsp.cfar import ca_cfar, goca_cfar, os_cfar, osca_cfar, soca_cfar, tm_cfar
from isacbench.errors import InputError
from isacbench.plugins.contracts import Detector

ALL = {"ca": CaCfar, "os": OsCfar, "osca": OscaCfar, "goca": GocaCfar, "soca": SocaCfar, "tm": TmCfar}
EACH = pytest.mark.parametrize("detector", ALL.values(), ids=ALL)


@pytest.mark.parametrize(("name", "detector"), ALL.items(), ids=ALL)
def test_detector_is_registered_fulfils_the_contract_and_is_hashable(name, detector):
    assert detector.name == name
    assert get_detector(name) == detector()
    assert isinstance(detector(), Detector)
    assert hash(detector()) == hash(detector())


def test_defaults_are_the_papers_windows_at_1e_minus_3():
    power = np.random.default_rng(0).standard_exponential((20, 20))
    for found, expected in (
        (CaCfar().detect(power), ca_cfar(power, 3, 1, 1e-3)),
        (OscaCfar().detect(power), osca_cfar(power, 4, None, 1e-3)),
        (OsCfar().detect(power), os_cfar(power, 3, 1, 1e-3, rank_fraction=0.75)),
        (GocaCfar().detect(power), goca_cfar(power, 3, 1, 1e-3, split_axis=0)),
        (SocaCfar().detect(power), soca_cfar(power, 3, 1, 1e-3, split_axis=0)),
        (TmCfar().detect(power), tm_cfar(power, 3, 1, 1e-3, trim_low=0.25, trim_high=0.25)),
    ):
        assert np.array_equal(found.threshold, expected.threshold)
        assert np.array_equal(found.mask, expected.mask)


def test_parameters_and_looks_reach_the_detector():
    power = np.random.default_rng(0).standard_gamma(8, (20, 20)) / 8
    for found, expected in (
        (CaCfar(0.1, (2, 4), (1, 0), "paper").detect(power, 8), ca_cfar(power, (2, 4), (1, 0), 0.1, "paper")),
        (OscaCfar(0.1, (2, 3), 1).detect(power, 8), osca_cfar(power, (2, 3), 1, 0.1, looks=8)),
        (
            OscaCfar(0.1, (2, 3), 1, order_axis=1).detect(power, 8),
            osca_cfar(power, (2, 3), 1, 0.1, looks=8, order_axis=1),
        ),
        (
            OsCfar(0.1, (2, 3), 0, rank_fraction=0.5).detect(power, 8),
            os_cfar(power, (2, 3), 0, 0.1, looks=8, rank_fraction=0.5),
        ),
        (
            GocaCfar(0.1, (2, 3), 0, split_axis=1).detect(power, 8),
            goca_cfar(power, (2, 3), 0, 0.1, looks=8, split_axis=1),
        ),
        (
            SocaCfar(0.1, (2, 3), 0, split_axis=1).detect(power, 8),
            soca_cfar(power, (2, 3), 0, 0.1, looks=8, split_axis=1),
        ),
        (
            TmCfar(0.1, (2, 3), 0, trim_low=0.1, trim_high=0.5).detect(power, 8),
            tm_cfar(power, (2, 3), 0, 0.1, looks=8, trim_low=0.1, trim_high=0.5),
        ),
    ):
        assert np.array_equal(found.threshold, expected.threshold)


@EACH
@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"pfa": 0}, "pfa = 0"),
        ({"pfa": 1.5}, "pfa = 1.5"),
        ({"training": 0}, "training = 0"),
        ({"training": (-1, 2)}, "training ="),
        ({"training": None}, "training = None"),
        ({"guard": -1}, "guard = -1"),
        ({"guard": (1, 0.5)}, "guard ="),
        ({"threshold": "approximate"}, "threshold = 'approximate'"),
    ],
)
def test_bad_parameter_is_refused_on_construction_by_name(detector, parameters, message):
    with pytest.raises(InputError, match=message):
        detector(**parameters)


@pytest.mark.parametrize("detector", [CaCfar, OsCfar, GocaCfar, SocaCfar, TmCfar])
def test_only_osca_accepts_a_guard_of_none(detector):
    with pytest.raises(InputError, match="guard = None"):
        detector(guard=None)


@pytest.mark.parametrize(
    ("detector", "parameters", "message"),
    [
        (OsCfar, {"rank_fraction": 2}, "rank_fraction = 2"),
        (OscaCfar, {"order_axis": -1}, "order_axis = -1"),
        (GocaCfar, {"split_axis": -1}, "split_axis = -1"),
        (SocaCfar, {"split_axis": 0.5}, "split_axis = 0.5"),
        (TmCfar, {"trim_low": 0.7, "trim_high": 0.3}, "together below 1"),
    ],
)
def test_bad_parameter_of_one_detector_is_refused_on_construction_by_name(detector, parameters, message):
    with pytest.raises(InputError, match=message):
        detector(**parameters)


@EACH
def test_listed_cells_are_tested_as_in_the_whole_map(detector):
    power = np.random.default_rng(1).standard_exponential((20, 20))
    cells = np.nonzero(power > 2)
    whole, listed = detector().detect(power), detector().detect(power, cells=cells)
    assert np.array_equal(listed.mask, whole.mask[cells])
    assert np.array_equal(listed.threshold, whole.threshold[cells])
