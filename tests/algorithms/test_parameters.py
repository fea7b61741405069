"""Parameters: refused out of range, by name and with what is allowed; defaults; the fixed threshold."""

import dataclasses
import math

import numpy as np
import pytest
from isacbench_algorithms.detectors import FixedThreshold
from isacbench_algorithms.music2d import Music2d

from isacbench.errors import InputError
from isacbench.plugins.registry import detector_names, get_detector
from tests.algorithms.scenes import BUILT_IN

PLUGINS = {one.name: type(one) for one in (*BUILT_IN, *map(get_detector, detector_names()))}
FRAMED = ["ca", "os", "goca", "soca", "tm"]
LINES = ["music2d", "fft4d"]
JOINT = ["esprit2d", "music2d_joint"]
SPECTRA = ["bartlett2d", "capon2d", "iaa2d"]
CELLWISE = [*LINES, *JOINT, *SPECTRA]
REFUSED = [
    ([*FRAMED, "osca"], "pfa", [0, 1.5], "pfa = "),
    ([*FRAMED, "osca"], "training", [0, -1, None, (-1, 2)], "training = "),
    ([*FRAMED, "osca"], "guard", [-1, (1, 0.5)], "guard = "),
    ([*FRAMED, "osca"], "threshold", ["approximate"], "threshold = 'approximate'"),
    (FRAMED, "guard", [None], "guard = None"),
    (["os"], "rank_fraction", [2, math.nan, "0.5"], "rank_fraction = "),
    (["tm"], "trim_low", [-0.1], r"trim_low = -0\.1"),
    (["tm"], "trim_high", [1.5], r"trim_high = 1\.5"),
    (["tm"], "trim_low", [0.75], "together below 1"),
    (["osca"], "order_axis", [-1], "order_axis = -1"),
    (["goca", "soca"], "split_axis", [-1, 0.5], "split_axis = "),
    (CELLWISE, "max_sources", [0], "max_sources = 0: allowed is 1 and more"),
    (CELLWISE, "angle_pfa", [0.0, math.nan], "angle_pfa = .*: allowed is between 0 and 1"),
    (CELLWISE, "m_of_n", [2], 'm_of_n = 2: allowed is 1, or a number with integration "binary"'),
    (CELLWISE, "dynamic_range_db", [0.0], r"dynamic_range_db = 0\.0: allowed is above 0"),
    (CELLWISE, "local_dynamic_range_db", [-1.0], r"local_dynamic_range_db = -1\.0: allowed is above 0"),
    (CELLWISE, "doppler_excess", [0.9], r"doppler_excess = 0\.9: allowed is 1 and more"),
    (CELLWISE, "largest_direction_error", [0.0], r"direction_error = 0\.0: allowed is above 0, or none"),
    (CELLWISE, "detection_window", ["flat"], "detection_window = 'flat': allowed is one of rect, soft"),
    (CELLWISE, "pfa", [2.0], r"pfa = 2\.0"),
    ([*LINES, *JOINT], "precision", ["half"], "precision = 'half': allowed is one of double, single"),
    (["music2d", *JOINT, "capon2d"], "subarray_fraction", [0.0, 1.5], "subarray_fraction = .*up to 1"),
    (["music2d", *JOINT], "model_order", ["best"], "model_order"),
    (["music2d"], "grid_points", [64], "grid_points = 64: allowed is 65 and more"),
    (["music2d"], "max_order", [0], "max_order = 0: allowed is 1 and more"),
    (["fft4d"], "angle_points", [2], "angle_points = 2: allowed is 3 and more"),
    (["fft4d", *SPECTRA], "angle_dynamic_range_db", [0.0], r"dynamic_range_db = 0\.0: allowed is above"),
    (SPECTRA, "samples_per_cell", [1], "samples_per_cell"),
    (["music2d_joint"], "samples_per_lobe", [3], "samples_per_lobe"),
    ([*JOINT, "iaa2d"], "polish", [-1], "polish"),
    (["capon2d"], "loading_db", [300.0], "loading_db"),
    (["iaa2d"], "iterations", [0], "iterations"),
    (["nomp4d"], "pfa", [0.0, math.nan], "pfa = .*: allowed is between 0 and 1|pfa = nan"),
    (["nomp4d"], "local_dynamic_range_db", [0.0], r"local_dynamic_range_db = 0\.0: allowed is above 0"),
    (["nomp4d"], "max_rounds", [0], "max_rounds = 0: allowed is 1 and more"),
    (["nomp4d", "sbl4d"], "max_scatterers", [0], "max_scatterers = 0"),
    (["sbl4d"], "lone_scatterers", [-1], "lone_scatterers"),
    (["oracle"], "cell", [0.0, -1.0, math.inf, math.nan], "cell = .*a positive number of Rayleigh"),
]


@pytest.mark.parametrize(
    ("plugin", "name", "value", "message"),
    [
        pytest.param(plugin, name, value, message, id=f"{plugin}-{name}-{value}")
        for plugins, name, values, message in REFUSED
        for plugin in plugins
        for value in values
    ],
)
def test_a_parameter_out_of_range_is_refused_by_name_and_with_what_is_allowed(plugin, name, value, message):
    with pytest.raises(InputError, match=message):
        PLUGINS[plugin](**{name: value})


def test_product_pairing_needs_spectra():
    with pytest.raises(InputError, match="joint with search = root"):
        Music2d(search="root", pairing="product")


def test_defaults_are_the_papers_windows_at_1e_minus_3():
    framed = {"pfa": 1e-3, "training": 3, "guard": 1, "threshold": "exact"}
    for name, own in (
        *(("ca", {}), ("os", {"rank_fraction": 0.75}), ("tm", {"trim_low": 0.25, "trim_high": 0.25})),
        *(("goca", {"split_axis": 0}), ("soca", {"split_axis": 0})),
        ("osca", {"training": 4, "guard": None, "order_axis": 0}),
    ):
        values = dataclasses.asdict(get_detector(name))
        assert values == framed | own
        assert list(values)[:4] == list(framed)  # also the order of positional values


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
    n_maps = int(min(3000 / pfa, 200_000 / (shape[0] * shape[1])))
    maps = (rng.standard_gamma(looks, shape) for _ in range(n_maps))
    alarms = [FixedThreshold(pfa).detect(power, looks).mask.sum() for power in maps]
    # Cells of a map share a threshold; the spread over maps counts.
    spread = np.std(alarms) / np.sqrt(n_maps)
    assert abs(np.mean(alarms) - pfa * shape[0] * shape[1]) < 4.5 * spread


def test_a_fixed_threshold_needs_a_second_cell():
    with pytest.raises(InputError, match="map of 1 cells"):
        FixedThreshold().detect(np.ones((1, 1)))
