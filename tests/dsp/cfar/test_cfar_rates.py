"""The script that counts the false alarms for the documentation counts what the detectors decide."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from isacbench import get_detector


@pytest.fixture
def script(monkeypatch):
    """Return the script as a module, with few windows a chunk."""
    path = Path(__file__).resolve().parents[3] / "docs" / "scripts" / "false_alarm_rates.py"
    spec = importlib.util.spec_from_file_location("false_alarm_rates", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "N_CHUNK", 100)
    monkeypatch.setattr(module, "RATES", (0.3, 0.1, 1e-3))
    return module


def test_alarms_are_those_of_every_window_tested_at_every_rate(script):
    alarms = script.count_chunk(1, 0)
    power = np.random.default_rng([1, 0]).standard_gamma(1, (9, 9, 100))
    assert alarms.shape == (len(script.NAMES), len(script.PLACES), 3)
    for name in ("ca", "soca"):
        for j, place in enumerate(script.PLACES.values()):
            cells = (*np.repeat([place], 100, axis=0).T, np.arange(100))
            for k, pfa in enumerate(script.RATES):
                detector = get_detector(name, pfa=pfa, training=(3, 3, 0), guard=(1, 1, 0))
                expected = np.count_nonzero(detector.detect(power, cells=cells).mask)
                assert alarms[script.NAMES.index(name), j, k] == expected


def test_adjusted_p_values_are_those_of_holm(script):
    # 3 tests: 0.01 * 3, then the greater of 0.03 and 0.02 * 2, then of 0.04 and 0.03.
    np.testing.assert_allclose(script.holm(np.array([0.02, 0.01, 0.03])), [0.04, 0.03, 0.04])


def test_a_rate_far_off_is_set_in_bold_and_counted(script):
    shape = (len(script.NAMES), len(script.PLACES), 3)
    alarms = {looks: np.broadcast_to(np.array([3000, 1000, 10]), shape).copy() for looks in script.LOOKS}
    assert "0 lie outside" in "".join(script.report(alarms, 10_000))
    alarms[16][2, 1, 0] = 5000
    text = "".join(script.report(alarms, 10_000))
    assert "| osca | border | **5.000e-01** | 1.000e-01 |" in text
    assert "1 lie outside" in text
