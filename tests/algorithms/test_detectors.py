from __future__ import annotations

import numpy as np
import pytest
from isacbench_algorithms.detectors import CaCfar, OscaCfar

from isacbench.contracts import Detector
from isacbench.dsp.cfar import ca_cfar, osca_cfar
from isacbench.errors import InputError

BOTH = pytest.mark.parametrize("detector", [CaCfar, OscaCfar])


@BOTH
def test_detector_fulfils_the_contract_and_is_hashable(detector):
    assert isinstance(detector(), Detector)
    assert detector.name in ("ca", "osca")
    assert hash(detector()) == hash(detector())


def test_defaults_are_the_papers_windows_at_1e_minus_3():
    power = np.random.default_rng(0).standard_exponential((20, 20))
    for found, expected in (
        (CaCfar().detect(power), ca_cfar(power, 3, 1, 1e-3)),
        (OscaCfar().detect(power), osca_cfar(power, 4, None, 1e-3)),
    ):
        assert np.array_equal(found.threshold, expected.threshold)
        assert np.array_equal(found.mask, expected.mask)


def test_parameters_and_looks_reach_the_detector():
    power = np.random.default_rng(0).standard_gamma(8, (20, 20)) / 8
    for found, expected in (
        (CaCfar(0.1, (2, 4), (1, 0), "paper").detect(power, 8), ca_cfar(power, (2, 4), (1, 0), 0.1, "paper")),
        (OscaCfar(0.1, (2, 3), 1).detect(power, 8), osca_cfar(power, (2, 3), 1, 0.1, looks=8)),
    ):
        assert np.array_equal(found.threshold, expected.threshold)


@BOTH
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


def test_ca_refuses_a_guard_of_none():
    with pytest.raises(InputError, match="guard = None"):
        CaCfar(guard=None)
