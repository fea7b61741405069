"""A wrong image of a lone scatterer is called by its fault, with sidelobes or without, a right one passes."""

from dataclasses import dataclass
from itertools import combinations, product
from typing import Any, ClassVar

import numpy as np
import pytest

from isacbench.checking import scenes
from isacbench.checking.checks import CheckFailedError, DoubtfulError
from isacbench.checking.lone_scatterer import AXES, MISS_CELLS, places_of_mistakes, require_lone_scatterer
from isacbench.model.cloud import PointCloud
from isacbench.model.radio_coordinates import radio_places, rayleigh_cells
from tests.conftest import slow_but

BEAMS = 32
VIEWS = tuple(scenes.LONE_VIEWS)


SEEN = {}


def detected(observation, *options):
    """What the beamformer sees in the cells of an observation, formed once."""
    key = complex(observation.cells[0, 0, 0, 0]), options
    if key not in SEEN:
        SEEN[key] = beams_of(observation, *options)
    return SEEN[key]


def beams_of(observation, lowest_db, beams):
    """Range bin, Doppler bin, u, w and power of the beams of all cells, above a level below the peak."""
    spectrum = np.fft.ifft2(observation.cells, (beams, beams)) * beams**2
    power = np.abs(spectrum / np.prod(observation.array.shape)) ** 2 / observation.system.processing_gain
    row, column, i, j = np.nonzero(power >= power.max() * 10 ** (lowest_db / 10))
    cosine = 2 * np.fft.fftfreq(beams)
    gate = observation.gate
    bins = gate.range_bins[row].astype(float), gate.doppler_bins[column].astype(float)
    return *bins, cosine[i], cosine[j], power[row, column, i, j]


@dataclass(frozen=True)
class Beamformer:
    """Images the beams of the cells, and changes their places before or the image after it was placed."""

    name: ClassVar[str] = "beamformer"

    lowest_db: float = 0.0
    alike: bool = False
    beams: int = BEAMS
    placed: Any = None
    made: Any = None

    def estimate(self, observation):
        """Image one observation."""
        found = detected(observation, self.lowest_db, self.beams)
        if self.alike:
            found = *found[:4], np.ones_like(found[4])
        if self.placed:
            found = self.placed(observation, *found)
        cloud = observation.cloud(*found)
        return self.made(observation, cloud) if self.made else cloud


IMAGES = {
    "one point": {},
    "sidelobes": {"lowest_db": -30.0},
    "unpadded beams": {"lowest_db": -30.0, "beams": 10},
}
ALIKE = {"sidelobes as strong": {"lowest_db": -20.0, "alike": True}}


def judged(**options):
    """Look at the image of a beamformer."""
    return require_lone_scatterer(Beamformer(**options))


def message(error, **options):
    with pytest.raises(error) as caught:
        judged(**options)
    return str(caught.value)


def placing(change):
    """Change range bins, Doppler bins and directions before the image is placed."""
    return {"placed": lambda observation, *found: (*change(observation, *found[:4]), found[4])}


def by_hand(change):
    """Build the cloud without `observation.cloud`, from a changed range, velocity and directions."""

    def made(observation, cloud):
        offset_m = cloud.xyz - observation.base_station_m
        range_m, (u, w) = np.linalg.norm(offset_m, axis=1), observation.frame.direction_cosines(offset_m)
        range_m, velocity, u, w = change(observation, range_m, cloud.velocity, u, w)
        xyz = observation.base_station_m + observation.frame.offsets(range_m, u, w)
        return PointCloud(xyz, velocity, cloud.power)

    return {"made": made}


def speed_bin(observation):
    return observation.system.velocity_bin_mps


def gate_ends(observation):
    return observation.gate.range_bins[[0, -1]]


PLACED = {
    "range had the wrong sign": lambda o, r, d, u, w: (-r, d, u, w),
    "range had the wrong sign, of unsigned bins": lambda o, r, d, u, w: (512 - r, d, u, w),
    "range was there and back": lambda o, r, d, u, w: (2 * r, d, u, w),
    "range was halved once too often": lambda o, r, d, u, w: (r / 2, d, u, w),
    "range was in m where bins are wanted": lambda o, r, d, u, w: (r * o.system.range_bin_m, d, u, w),
    "velocity had the wrong sign": lambda o, r, d, u, w: (r, -d, u, w),
    "velocity was twice as large": lambda o, r, d, u, w: (r, 2 * d, u, w),
    "velocity was half as large": lambda o, r, d, u, w: (r, d / 2, u, w),
    "velocity was in m/s where bins are wanted": lambda o, r, d, u, w: (r, d * speed_bin(o), u, w),
    "u had the wrong sign": lambda o, r, d, u, w: (r, d, -u, w),
    "w had the wrong sign": lambda o, r, d, u, w: (r, d, u, -w),
    "u and w had the wrong signs": lambda o, r, d, u, w: (r, d, -u, -w),
    "u and w were swapped": lambda o, r, d, u, w: (r, d, w, u),
    "u and w were swapped and u had the wrong sign": lambda o, r, d, u, w: (r, d, -w, u),
    "velocity had the wrong sign and w had the wrong sign": lambda o, r, d, u, w: (r, -d, u, -w),
    "velocity had the wrong sign and u and w were swapped": lambda o, r, d, u, w: (r, -d, w, u),
    "range was there and back and velocity was twice as large": lambda o, r, d, u, w: (2 * r, 2 * d, u, w),
    "u and w were angles in radians": lambda o, r, d, u, w: (r, d, np.arcsin(u), np.arcsin(w)),
    "u and w were halved": lambda o, r, d, u, w: (r, d, u / 2, w / 2),
    "u and w were twice as large": lambda o, r, d, u, w: (r, d, 2 * u, 2 * w),
    "u and w were phases": lambda o, r, d, u, w: (r, d, np.pi * u, np.pi * w),
    "u and w began at -1 without numpy.fft.fftshift": lambda o, r, d, u, w: (r, d, u % 2 - 1, w % 2 - 1),
    "u and w ran from 0 to 1": lambda o, r, d, u, w: (r, d, u % 2 / 2, w % 2 / 2),
    "range was the index into the gate": lambda o, r, d, u, w: (r - gate_ends(o)[0], d, u, w),
    "velocity was the index into the gate": lambda o, r, d, u, w: (r, d - o.gate.doppler_bins[0], u, w),
    "range ran backwards through the gate": lambda o, r, d, u, w: (sum(gate_ends(o)) - r, d, u, w),
}
BY_HAND = {
    "range was there and back, by hand": lambda o, r, v, u, w: (2 * r, v, u, w),
    "range was in bins where m are wanted": lambda o, r, v, u, w: (r / o.system.range_bin_m, v, u, w),
    "velocity had the wrong sign, by hand": lambda o, r, v, u, w: (r, -v, u, w),
    "velocity was in km/h": lambda o, r, v, u, w: (r, 3.6 * v, u, w),
    "velocity was in bins where m/s are wanted": lambda o, r, v, u, w: (r, v / speed_bin(o), u, w),
    "velocity was 0": lambda o, r, v, u, w: (r, 0 * v, u, w),
}
PLACES = {name: placing(change) for name, change in PLACED.items()} | {
    name: by_hand(change) for name, change in BY_HAND.items()
}
IN_BOTH = {"u and w ran from 0 to 1", "velocity was the index into the gate"}
"""Mistakes that one view does not tell from others."""


@pytest.mark.parametrize(
    ("mistake", "image"),
    # The wide main lobes of equal powers hide what radians are off.
    [one for one in product(PLACES, IMAGES | ALIKE) if one != ("u and w were angles in radians", *ALIKE)],
)
def test_a_wrong_place_is_called_by_its_mistake(mistake, image):
    told = message(CheckFailedError, **(IMAGES | ALIKE)[image], **PLACES[mistake])
    assert told.startswith(f"images a lone scatterer where it would be if {mistake.partition(', ')[0]}: ")
    assert "frame)" not in told
    assert "power" not in told


@pytest.mark.parametrize("image", slow_but(["one point"], ["one point", "sidelobes"]))
@pytest.mark.parametrize("mistake", [one for one in PLACES if one not in IN_BOTH])
def test_a_wrong_place_in_the_paper_frame_alone_is_called_by_its_mistake(mistake, image):
    [(when, change)] = PLACES[mistake].items()
    told = message(CheckFailedError, **(IMAGES | ALIKE)[image], **{when: in_paper(when, change)})
    assert told.startswith(f"images a lone scatterer where it would be if {mistake.partition(', ')[0]}: ")
    assert told.endswith("(paper frame)")


def in_paper(when, change):
    """Change images in the paper's frame alone."""
    unchanged = {"placed": lambda observation, *found: found, "made": lambda observation, cloud: cloud}[when]

    def changed(observation, *what):
        is_paper = type(observation.frame).__name__ == "PaperFrame"
        return (change if is_paper else unchanged)(observation, *what)

    return changed


@pytest.mark.parametrize("image", IMAGES | ALIKE)
@pytest.mark.parametrize(
    ("angle", "told"),
    [
        (lambda u: np.rad2deg(np.arcsin(u)), "if u and w were angles in degrees: they are direction cosines"),
        (np.arccos, "directions of a lone scatterer reach 1.8: u and w are cosines, between -1 and 1"),
        (lambda u: u % 2, "if u and w ran from 0 to 2: subtract 2 above 1"),
    ],
)
def test_directions_that_are_no_cosines_are_called_so(angle, told, image):
    options = placing(lambda o, r, d, u, w: (r, d, angle(u), angle(w)))
    assert told in message(CheckFailedError, **(IMAGES | ALIKE)[image], **options)


@pytest.mark.parametrize("image", IMAGES)
def test_a_right_image_passes(image):
    assert judged(**IMAGES[image]).endswith(" m off in the paper frame")


def test_bins_of_another_turn_are_the_same():
    options = placing(lambda o, r, d, u, w: (r - o.system.n_subcarriers, d % o.system.n_symbols, u, w))
    assert judged(**options) == judged()


def test_sidelobes_at_all_places_of_mistakes_decide_nothing():
    """Each is an eighth as strong as the scatterer, together they are stronger."""

    def placed(observation, r, d, u, w, p):
        axes = np.meshgrid(r[0] * np.array([1, 2]), d[0] * np.array([1, -1]), [u[0], -u[0]], [w[0], -w[0]])
        echoes = [axis.ravel() for axis in np.transpose(axes, (0, 2, 1, 3, 4))]
        return *echoes, np.r_[p[0], np.full(15, p[0] / 8)]

    assert judged(placed=placed) == judged()


POWERS = {
    "divide by observation.system.processing_gain": lambda p, gain: p * gain,
    "as 1 and 1: a power is |G|² relative to": lambda p, gain: p / p.max(),
    "these follow the amplitude": lambda p, gain: p**0.5,
    "these follow the amplitude, divided": lambda p, gain: (p * gain) ** 0.5 / gain,
    "these are in dB": lambda p, gain: np.maximum(10 * np.log10(p * gain), 0),
    "these are in dB, of 20": lambda p, gain: 200 + 20 * np.log10(p),
    ": a power is |G|² relative to a unit": lambda p, gain: 900 * p,
    "as 0 and 0: a power is |G|² relative to": lambda p, gain: 0 * p,
}


@pytest.mark.parametrize("image", IMAGES)
@pytest.mark.parametrize("mistake", POWERS)
def test_a_wrong_power_at_the_right_place_is_called_by_its_mistake(mistake, image):
    def placed(observation, r, d, u, w, p):
        return r, d, u, w, POWERS[mistake](p, observation.system.processing_gain)

    told = message(DoubtfulError, **IMAGES[image], placed=placed)
    assert told.startswith("powers of 1 and 0.0001 come out as ")
    assert mistake.partition(", ")[0] in told


@pytest.mark.parametrize("image", ALIKE)
def test_points_as_strong_as_each_other_are_blamed_for_their_power_alone(image):
    told = message(DoubtfulError, **ALIKE[image])
    assert told.startswith("powers of 1 and 0.0001 come out as 1 and 1: a power is |G|²")


OFFSETS = [
    *(((one,), sign) for one in range(4) for sign in (1, -1)),
    *(((0, 1), -1), ((2, 3), 1), ((0, 1, 2, 3), -1)),
]


def moved(axes, by):
    """Move all points by so many Rayleigh cells along some axes."""

    def placed(observation, *found):
        cells = [1, 1, *(2 / n for n in observation.array.shape)]
        shift = by * np.array(cells) * np.isin(range(4), axes)
        return *(one + more for one, more in zip(found[:4], shift, strict=True)), found[4]

    return {"placed": placed}


@pytest.mark.parametrize("image", ["one point", "sidelobes"])
@pytest.mark.parametrize(("axes", "sign"), OFFSETS)
def test_half_a_bin_too_much_or_too_little_is_told_with_its_axis(axes, sign, image):
    told = message(DoubtfulError, **IMAGES[image], **moved(axes, sign / 2))
    names = [AXES[axis] for axis in axes]
    assert told.startswith(f"images lone scatterers about half a bin off in {names[0]} (")
    assert [axis for axis in AXES if f"{axis} (" in told] == names


@pytest.mark.parametrize("image", ["one point", "sidelobes"])
@pytest.mark.parametrize("cells", slow_but([3], [1, 2, 3]))
@pytest.mark.parametrize(("axes", "sign"), OFFSETS)
def test_whole_bins_too_much_or_too_little_are_a_failure_that_names_the_axes(axes, sign, cells, image):
    told = message(CheckFailedError, **IMAGES[image], **moved(axes, sign * cells))
    assert told.startswith("images of lone scatterers far above the noise are off by ")
    assert [axis for axis in AXES if f" in {axis}," in told] == [AXES[axis] for axis in axes]


CONSTANTS = {
    "range": lambda o, r, d, u, w: (0 * r + 20, d, u, w),
    "velocity": lambda o, r, d, u, w: (r, 0 * d + 5, u, w),
    "u": lambda o, r, d, u, w: (r, d, 0 * u, w),
    "u and w": lambda o, r, d, u, w: (r, d, 0 * u, 0 * w),
}


@pytest.mark.parametrize("image", IMAGES)
@pytest.mark.parametrize("axes", CONSTANTS)
def test_a_coordinate_that_does_not_follow_the_echo_is_told(axes, image):
    told = message(CheckFailedError, **IMAGES[image], **placing(CONSTANTS[axes]))
    assert told.startswith(f"images all lone scatterers at the same {axes}: ")


def test_the_middle_of_the_gate_is_no_range():
    options = placing(lambda o, r, d, u, w: (0 * r + o.gate.range_bins.mean().round(), d, u, w))
    assert " in range, in Rayleigh cells: " in message(CheckFailedError, **options)


def test_points_all_over_the_scene_are_blamed_for_their_powers_and_for_no_place():
    rng = np.random.default_rng(0)

    def placed(observation, *found):
        gate = observation.gate
        bins = rng.choice(gate.range_bins, 60), rng.choice(gate.doppler_bins, 60)
        axes = *bins, *rng.uniform(-1, 1, (2, 60))
        return *(np.r_[one, more] for one, more in zip(found[:4], axes, strict=True)), np.ones(61)

    assert "powers of 1 and 0.0001 come out as 1 and 1" in message(DoubtfulError, placed=placed)
    spread = {"lowest_db": -60.0, "alike": True, "beams": 20}
    assert "by points all over the scene, none of which stands out" in message(DoubtfulError, **spread)


@pytest.mark.parametrize("rounding", [np.floor, np.ceil, np.trunc])
def test_a_bin_that_is_not_the_nearest_is_told(rounding):
    """The estimator has found the places exactly, and rounds them to bins."""

    def placed(observation, r, d, u, w, p):
        _, echo = scenes.LONE_VIEWS["panel" if observation.region.z_m[1] > 70 else "paper"]
        return [rounding(echo.range_bin)], [rounding(echo.doppler_bin)], [echo.u], [echo.w], p[:1]

    told = message(DoubtfulError, placed=placed)
    assert "half a bin off in range" in told
    assert "velocity" in told
    assert "take the nearest bin" in told


def test_half_a_bin_and_a_wrong_power_are_both_told():
    told = message(DoubtfulError, placed=lambda o, r, d, u, w, p: (r + 0.5, d, u, w, 1e4 * p))
    assert "half a bin off in range" in told
    assert "; and powers of 1 and 0.0001 come out as" in told


def middle(observation, cloud):
    return PointCloud([(observation.region.lower_m + observation.region.upper_m) / 2], [0.0], [1.0])


@pytest.mark.parametrize(
    "fault", [{"placed": lambda *_: ([24.0], [0.0], [0.3], [0.8], [1.0])}, {"made": middle}]
)
def test_one_point_for_all_cells_is_called_so(fault):
    assert "whatever the cells hold" in message(CheckFailedError, **fault)


def test_nothing_where_one_scatterer_stands_out_is_a_failure():
    told = message(CheckFailedError, made=lambda observation, cloud: PointCloud.empty())
    assert told.startswith("drops a lone scatterer that it has placed rightly")


def test_no_two_mistakes_lead_to_the_same_places():
    apart = []
    for frame in VIEWS:
        scene = scenes.lone(frame)
        true = radio_places(scene.scenario, scene.scenario.truth)[0] / rayleigh_cells(scene.scenario)
        mistakes, places, _ = map(list, zip(*places_of_mistakes(scene, true), strict=True))
        assert mistakes[0] == ()
        np.testing.assert_array_equal(places[0], true)
        apart.append(np.abs(np.array(places)[:, None] - np.array(places)).max(axis=2))
    assert (np.maximum(*apart) + 9 * np.eye(len(places))).min() > 0.5


@pytest.mark.parametrize("frame", VIEWS)
def test_no_mistake_of_signs_or_of_order_is_near_another_or_outside_the_region(frame):
    scene = scenes.lone(frame)
    [(range_m, _, u, w)] = radio_places(scene.scenario, scene.scenario.truth)
    cells = rayleigh_cells(scene.scenario)[2:]
    mirrored = [(a * p, b * q) for p, q in ((u, w), (w, u)) for a in (1, -1) for b in (1, -1)]
    for one, two in combinations(mirrored, 2):
        assert (np.abs(np.subtract(one, two)) / cells).max() > MISS_CELLS
    for place in mirrored:
        xyz = scene.scenario.base_station_m + scene.scenario.frame.offsets([range_m], *np.array([place]).T)
        assert scene.scenario.region.contains(xyz, -1.0).all()
