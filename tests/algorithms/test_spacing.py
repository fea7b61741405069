"""Arrays whose elements are not half a wavelength apart: every estimator finds a target where it is."""

import numpy as np
import pytest

from isacbench import get_estimator, load_scenario, observe
from isacbench.model.radio_coordinates import radio_places, rayleigh_cells

ESTIMATORS = (
    *("fft4d", "bartlett2d", "capon2d", "iaa2d", "music2d", "music2d_joint", "esprit2d"),
    *("omp4d", "nomp4d", "sbl4d"),
)
VARIANTS = (
    *(("music2d", {"search": "root"}), ("music2d", {"pairing": "product"})),
    *((name, {"integration": "element"}) for name in ("music2d", "fft4d")),
)
SCENE = """
name = "spaced"
[system]
carrier_hz = 4.9e9
subcarrier_spacing_hz = 30e3
n_subcarriers = 512
n_symbols = 56
cyclic_prefix_ratio = 0.07142857
cyclic_suffix_ratio = 0.0
[array]
frame = "panel"
spacing_wavelengths = {spacing}
tx_shape = [1, 1]
tx_spacing = 1
rx_shape = [8, 8]
rx_spacing = 1
[base_station]
position_m = [0.0, 0.0, 25.0]
[region]
x_m = [-80.0, 80.0]
y_m = [-90.0, -30.0]
z_m = [25.0, 150.0]
speed_mps = [-60.0, 60.0]
[[objects]]
kind = "point"
position_m = [{x}, {y}, {z}]
velocity_mps = 20.0
"""
# In the second place |w| is 1.3, so that its phases alias.
PLACES = (20.0, -70.0, 45.0), (-15.0, -60.0, 110.0)


@pytest.fixture
def load_spaced(tmp_path):
    """Return a function that loads a point before an array of some spacing."""

    def build(spacing, place):
        path = tmp_path / "spaced.toml"
        x, y, z = place
        path.write_text(SCENE.format(spacing=list(spacing), x=x, y=y, z=z))
        return load_scenario(path)

    return build


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("spacing", [(0.5, 0.8), (0.4, 0.45)])
def test_every_estimator_finds_a_target_to_within_its_rayleigh_cell(load_spaced, spacing, place):
    scenario = load_spaced(spacing, place)
    all_find_it(scenario)


@pytest.mark.filterwarnings("ignore:.*look alike along u")
def test_every_estimator_finds_a_target_where_the_region_spans_more_than_a_period(load_spaced):
    scenario = load_spaced((0.8, 0.8), PLACES[0])
    (lowest, highest), _ = observe(scenario, 0.0).cosine_limits
    assert highest - lowest == pytest.approx(2)
    all_find_it(scenario)


def all_find_it(scenario):
    observation = observe(scenario, 0.0)
    for name, parameters in (*((name, {}) for name in ESTIMATORS), *VARIANTS):
        cloud = get_estimator(name, **parameters).estimate(observation)
        error = radio_places(scenario, cloud) - radio_places(scenario, scenario.scatterers)
        assert (np.abs(error) < rayleigh_cells(scenario)).all(axis=1).sum() == 1, (name, parameters)
        assert len(cloud) == 1, (name, parameters)
