from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from isacbench_algorithms.detectors import (
    CaCfar,
    FixedThreshold,
    GocaCfar,
    OscaCfar,
    OsCfar,
    SocaCfar,
    TmCfar,
)

from isacbench.errors import InputError


def test_defaults_are_the_papers_windows_at_1e_minus_3():
    framed = {"pfa": 1e-3, "training": 3, "guard": 1, "threshold": "exact"}
    for detector, own in (
        (CaCfar, {}),
        (OscaCfar, {"training": 4, "guard": None, "order_axis": 0}),
        (OsCfar, {"rank_fraction": 0.75}),
        (GocaCfar, {"split_axis": 0}),
        (SocaCfar, {"split_axis": 0}),
        (TmCfar, {"trim_low": 0.25, "trim_high": 0.25}),
    ):
        assert dataclasses.asdict(detector()) == framed | own
        assert list(dataclasses.asdict(detector()))[:4] == list(framed)  # also the order of positional values


def test_a_fixed_threshold_is_one_for_the_whole_map_whatever_it_lists():
    power = np.random.default_rng(0).standard_exponential((40, 30)) * np.linspace(1, 50, 30)
    found = FixedThreshold(1e-2).detect(power)
    assert np.ptp(found.threshold) == np.ptp(found.noise) == 0
    assert found.noise[0, 0] == sorted(power.ravel())[599]
    listed = FixedThreshold(1e-2).detect(power, cells=np.nonzero(power > 20))
    np.testing.assert_array_equal(listed.mask, found.mask[power > 20])


@pytest.mark.parametrize("pfa", [0.01, 0.3])
@pytest.mark.parametrize(("shape", "looks"), [((2, 1), 1), ((3, 3), 1), ((3, 3), 4), ((31, 20), 16)])
def test_a_fixed_threshold_keeps_its_rate_in_noise_on_maps_of_any_size(pfa, shape, looks):
    rng = np.random.default_rng(1)
    n_maps = 200_000 // (shape[0] * shape[1])
    alarms = [
        FixedThreshold(pfa).detect(rng.standard_gamma(looks, shape), looks).mask.sum() for _ in range(n_maps)
    ]
    # Cells of a map share a threshold; the spread over maps counts.
    spread = np.std(alarms) / np.sqrt(n_maps)
    assert abs(np.mean(alarms) - pfa * shape[0] * shape[1]) < 4.5 * spread


def test_a_fixed_threshold_needs_a_second_cell():
    with pytest.raises(InputError, match="map of 1 cells"):
        FixedThreshold().detect(np.ones((1, 1)))
