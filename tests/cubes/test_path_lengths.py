"""Frames computed from path lengths alone are imaged where their scatterer is, however elements count."""

from dataclasses import replace

import numpy as np
import pytest

from isacbench.cubes.frame import observe_cube
from isacbench.cubes.writing import FrameSimulator
from isacbench.errors import InputError, InputWarning
from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator
from isacbench.model.frame import get_frame
from isacbench.model.numerology import System
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers, Scenario
from isacbench.plugins.registry import get_estimator

LIGHT_MPS = 299_792_458.0
ORDERS = [("-u", "-w"), ("+u", "-w"), ("-u", "+w"), ("+u", "+w")]
SPEED_MPS = 7.3


def scenario_of(ascending, yaw_deg=0.0, tilt_deg=0.0, place=(3.0, 10.0, 5.0), spacing=(0.5, 0.5)):
    return Scenario(
        name="path lengths",
        system=System(n_subcarriers=128, n_symbols=56),
        array=VirtualArray((1, 1), (8, 6), 1, 1, ascending),
        frame=get_frame("panel", yaw_deg, tilt_deg, spacing),
        base_station_m=np.array([0.0, 60.0, 10.0]),
        region=Region((-60.0, 60.0), (0.0, 60.0), (-10.0, 30.0), (-40.0, 40.0)),
        scatterers=Scatterers(np.array([place]), np.array([SPEED_MPS]), np.ones(1)),
    )


def frame_of(scenario, yaw_deg, tilt_deg):
    """Phases exp(-j2πfτ) of the paths from the base station to the scatterer and back to each element."""
    system, base_m, place = scenario.system, scenario.base_station_m, scenario.scatterers.xyz[0]
    yaw, tilt = np.radians([yaw_deg, tilt_deg])
    along_u, ahead = np.array([np.cos(yaw), np.sin(yaw), 0]), np.array([np.sin(yaw), -np.cos(yaw), 0])
    along_w = np.cos(tilt) * np.array([0, 0, -1]) - np.sin(tilt) * ahead
    p, q = np.meshgrid(*map(np.arange, scenario.array.shape), indexing="ij")
    sign_u, sign_w = (1 if axis[0] == "+" else -1 for axis in scenario.array.ascending)
    apart_u, apart_w = LIGHT_MPS / system.carrier_hz * np.array(scenario.frame.spacing_wavelengths)
    elements_m = base_m + apart_u * sign_u * p[..., None] * along_u
    elements_m += apart_w * sign_w * q[..., None] * along_w
    path_m = np.linalg.norm(place - base_m) + np.linalg.norm(place - elements_m, axis=-1)
    symbol_s = (1 + system.cyclic_prefix_ratio) / system.subcarrier_spacing_hz
    delay_s = path_m / LIGHT_MPS
    shortening_s = 2 * SPEED_MPS / LIGHT_MPS * symbol_s * np.arange(system.n_symbols)
    frequency_hz = system.carrier_hz + system.subcarrier_spacing_hz * np.arange(system.n_subcarriers)
    turns = frequency_hz[:, None, None, None] * (delay_s - shortening_s[:, None, None])
    return np.exp(-2j * np.pi * turns)


@pytest.mark.parametrize(("yaw_deg", "tilt_deg"), [(0.0, 0.0), (20.0, 12.0)])
@pytest.mark.filterwarnings("ignore:.*look alike along")
@pytest.mark.parametrize("spacing", [(0.5, 0.5), (0.5, 0.8), (0.7, 0.4)])
@pytest.mark.parametrize("ascending", ORDERS)
def test_a_frame_of_path_lengths_is_imaged_where_its_scatterer_is(ascending, spacing, yaw_deg, tilt_deg):
    scenario = scenario_of(ascending, yaw_deg, tilt_deg, spacing=spacing)
    seen = observe_cube(frame_of(scenario, yaw_deg, tilt_deg), scenario)
    for estimator in (get_estimator("music2d"), get_estimator("music2d", integration="element")):
        cloud = estimator.estimate(seen)
        np.testing.assert_allclose(cloud.xyz, scenario.scatterers.xyz, atol=0.05)
        np.testing.assert_allclose(cloud.velocity, SPEED_MPS, atol=0.05)


def test_a_region_with_directions_that_look_alike_is_warned_of():
    warning = (
        "path lengths: .* alike along u, where elements are 0.7 wave.* span 2.00, and 1.43 would be unam"
    )
    with pytest.warns(InputWarning, match=warning):
        scenario_of(ORDERS[0], spacing=(0.7, 0.4))


@pytest.mark.parametrize(("y_m", "spacing"), [(-10.0, 0.6), (100.0, 0.8)])
def test_directions_also_look_alike_between_the_corners_of_a_region_and_around_the_array(y_m, spacing):
    # The widest directions are those of edges at the height of the array, or it sees a whole half-space.
    scenario = scenario_of(ORDERS[0])
    region, base_station_m = Region((-60.0, 60.0), (-60.0, y_m), (-80.0, 80.0), (-40.0, 40.0)), np.zeros(3)
    scatterers = replace(scenario.scatterers, xyz=np.array([[3.0, -20.0, 5.0]]))
    placed = replace(scenario, base_station_m=base_station_m, region=region, scatterers=scatterers)
    with pytest.warns(InputWarning, match="look alike along u"):
        replace(placed, frame=get_frame("panel", spacing_wavelengths=(spacing, 0.4)))


@pytest.mark.parametrize("ascending", ORDERS)
def test_a_simulated_frame_is_written_in_the_order_in_which_it_is_read(ascending):
    scenario = replace(scenario_of(ascending), gain_error_db=1.0)
    written = np.concatenate([*FrameSimulator(scenario, 10.0).blocks()])
    wanted, seen = Simulator(scenario).observe(10.0), observe_cube(written, scenario)
    np.testing.assert_allclose(seen.cells, wanted.cells, atol=1e-10)
    np.testing.assert_allclose(observe_cube(written, scenario).cross, wanted.cross, atol=1e-10)


def test_an_unknown_order_of_the_elements_is_refused():
    with pytest.raises(InputError, match=r"array.ascending = \('w', 'u'\): allowed is -u or \+u"):
        VirtualArray(ascending=("w", "u"))
