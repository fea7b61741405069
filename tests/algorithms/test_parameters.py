"""Parameters out of range are refused on construction, by name and with what is allowed."""

import math

import pytest
from isacbench_algorithms.bartlett2d import Bartlett2d
from isacbench_algorithms.capon2d import Capon2d
from isacbench_algorithms.detectors import CaCfar, GocaCfar, OscaCfar, OsCfar, SocaCfar, TmCfar
from isacbench_algorithms.esprit2d import Esprit2d
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.iaa2d import Iaa2d
from isacbench_algorithms.music2d import Music2d
from isacbench_algorithms.music2d_joint import Music2dJoint
from isacbench_algorithms.nomp4d import Nomp4d
from isacbench_algorithms.references import Oracle
from isacbench_algorithms.sbl4d import Sbl4d

from isacbench.checking.scenes import RESOLVED, observed
from isacbench.errors import InputError
from isacbench.plugins.registry import get_detector, get_estimator

FRAMED = [CaCfar, OsCfar, GocaCfar, SocaCfar, TmCfar]
LINES = [Music2d, Fft4d]
JOINT = [Esprit2d, Music2dJoint]
SPECTRA = [Bartlett2d, Capon2d, Iaa2d]
CELLWISE = [*LINES, *JOINT, *SPECTRA]
REFUSED = [
    ([*FRAMED, OscaCfar], "pfa", [0, 1.5], "pfa = "),
    ([*FRAMED, OscaCfar], "training", [0, -1, None, (-1, 2)], "training = "),
    ([*FRAMED, OscaCfar], "guard", [-1, (1, 0.5)], "guard = "),
    ([*FRAMED, OscaCfar], "threshold", ["approximate"], "threshold = 'approximate'"),
    (FRAMED, "guard", [None], "guard = None"),
    ([OsCfar], "rank_fraction", [2, math.nan, "0.5"], "rank_fraction = "),
    ([TmCfar], "trim_low", [-0.1], r"trim_low = -0\.1"),
    ([TmCfar], "trim_high", [1.5], r"trim_high = 1\.5"),
    ([TmCfar], "trim_low", [0.75], "together below 1"),
    ([OscaCfar], "order_axis", [-1], "order_axis = -1"),
    ([GocaCfar, SocaCfar], "split_axis", [-1, 0.5], "split_axis = "),
    (CELLWISE, "max_sources", [0], "max_sources = 0: allowed is 1 and more"),
    (CELLWISE, "angle_pfa", [0.0, math.nan], "angle_pfa = .*: allowed is between 0 and 1"),
    (CELLWISE, "dynamic_range_db", [0.0], r"dynamic_range_db = 0\.0: allowed is above 0"),
    (CELLWISE, "local_dynamic_range_db", [-1.0], r"local_dynamic_range_db = -1\.0: allowed is above 0"),
    (CELLWISE, "doppler_excess", [0.9], r"doppler_excess = 0\.9: allowed is 1 and more"),
    (CELLWISE, "largest_direction_error", [0.0], r"direction_error = 0\.0: allowed is above 0, or none"),
    (CELLWISE, "detection_window", ["flat"], "detection_window = 'flat': allowed is one of rect, soft"),
    (CELLWISE, "pfa", [2.0], r"pfa = 2\.0"),
    ([*LINES, *JOINT], "precision", ["half"], "precision = 'half': allowed is single or double"),
    ([Music2d, *JOINT, Capon2d], "subarray_fraction", [0.0, 1.5], "subarray_fraction = .*above 0, up to 1"),
    ([Music2d, *JOINT], "model_order", ["best"], "model_order"),
    ([Music2d], "grid_points", [64], "grid_points = 64: allowed is 65 and more"),
    ([Music2d], "max_order", [0], "max_order = 0: allowed is 1 and more"),
    ([Fft4d], "angle_points", [2], "angle_points = 2: allowed is 3 and more"),
    ([Fft4d, *SPECTRA], "angle_dynamic_range_db", [0.0], r"angle_dynamic_range_db = 0\.0: allowed is above"),
    (SPECTRA, "samples_per_cell", [1], "samples_per_cell"),
    ([Music2dJoint], "samples_per_lobe", [3], "samples_per_lobe"),
    ([*JOINT, Iaa2d], "polish", [-1], "polish"),
    ([Capon2d], "loading_db", [300.0], "loading_db"),
    ([Iaa2d], "iterations", [0], "iterations"),
    ([Nomp4d], "pfa", [0.0, math.nan], "pfa = .*: allowed is between 0 and 1|pfa = nan"),
    ([Nomp4d], "local_dynamic_range_db", [0.0], r"local_dynamic_range_db = 0\.0: allowed is above 0"),
    ([Nomp4d], "max_rounds", [0], "max_rounds = 0: allowed is 1 and more"),
    ([Nomp4d, Sbl4d], "max_scatterers", [0], "max_scatterers = 0"),
    ([Sbl4d], "lone_scatterers", [-1], "lone_scatterers"),
    ([Oracle], "cell", [0.0, -1.0, math.inf, math.nan], "cell = .*allowed is a positive number of Rayleigh"),
]


@pytest.mark.parametrize(
    ("plugin", "name", "value", "message"),
    [
        pytest.param(plugin, name, value, message, id=f"{plugin.name}-{name}-{value}")
        for plugins, name, values, message in REFUSED
        for plugin in plugins
        for value in values
    ],
)
def test_a_parameter_out_of_range_is_refused_by_name_and_with_what_is_allowed(plugin, name, value, message):
    with pytest.raises(InputError, match=message):
        plugin(**{name: value})


def test_product_pairing_needs_spectra():
    with pytest.raises(InputError, match="joint with search = root"):
        Music2d(search="root", pairing="product")


def test_a_window_larger_than_the_map_is_refused():
    detector = get_detector("osca", training=40, order_axis=1)
    with pytest.raises(InputError, match="window"):
        get_estimator("music2d", detector=detector).estimate(observed(RESOLVED, 20.0).observation())
