"""The families of generated scenes: what is drawn, and where it stands.

Every function takes the parameters of a family and the key of its uniforms,
and returns the content of a scenario file without its name. Region and speeds
are constants of the family. Frame, carrier phases and array errors do not
change what is drawn. All lengths are decimal numbers, so that a scene can be
written to a file and read again.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from isacbench.errors import InputError
from isacbench.model.array import VirtualArray
from isacbench.model.frame import get_frame
from isacbench.model.numerology import System
from isacbench.model.scenes.objects import heading
from isacbench.model.scenes.placement import MOST_TRIES, FreeGround, Sampler
from isacbench.model.scenes.scene_families import (
    CrowdParameters,
    DensityParameters,
    FamilySpec,
    SparseParameters,
    StreetParameters,
    WeakParameters,
)
from isacbench.model.scenes.urban_cell import draw_uma_av

Content = dict[str, Any]
Place = tuple[float, float]
Pose = tuple[float, float, float]

SQUARE: Content = {
    "base_station": {"position_m": [20.0, 100.0, 20.0]},
    "region": {"x_m": [0.0, 40.0], "y_m": [0.0, 30.0], "z_m": [0.0, 20.0], "speed_mps": [-25.0, 25.0]},
}
"""Base station and region of all families but ``uma-av``."""

FASTEST_MPS = 12.0
"""Speed of vehicles: the highest point of a wheel has twice as much."""

LONE_Z_M = 0.0, 15.0
"""Heights of lone scatterers: at that of the base station the paper's frame has no direction."""

RANGES: dict[str, dict[str, tuple[int, int]]] = {
    "low": {"vehicle": (1, 1), "pedestrian": (1, 3), "pole": (1, 2), "rail": (0, 1), "hedge": (0, 1)},
    "medium": {"vehicle": (1, 3), "pedestrian": (3, 6), "pole": (2, 4), "rail": (1, 2), "hedge": (1, 2)},
    "high": {"vehicle": (4, 6), "pedestrian": (8, 14), "pole": (4, 6), "rail": (2, 3), "hedge": (2, 3)},
}
"""Least and largest number of each object of a town, by density."""


def draw_street(parameters: StreetParameters, key: str) -> Content:
    """Draw the paper's objects elsewhere, mirrored and turned.

    All have one heading, but stand anywhere: two cars drive in opposite
    directions, two pedestrians each walk in either direction, and a green belt
    and two lamp posts stand.
    """
    draws, ground = Sampler(key), _free_ground()
    along_deg = draws.between(-90.0, 90.0, 1)
    speed_mps = draws.between(5.0, FASTEST_MPS, 1)
    mirrored = draws.either()
    place = _anywhere(draws)

    def anywhere(yaw_deg: float) -> Callable[[], Pose]:
        return lambda: _mirrored((*place(), yaw_deg), mirrored)

    objects = [_placed(ground, {"kind": "green_belt"}, (1.0, 20.0), anywhere(along_deg))]
    for turn_deg in (0.0, 180.0):
        pose = anywhere(along_deg + turn_deg + draws.between(-5.0, 5.0, 1))
        objects.append(_moving(_placed(ground, {"kind": "car"}, (2.0, 6.0), pose), speed_mps))
    for _ in range(2):
        post = {"kind": "lamp_post", "spacing_m": 0.5}
        objects.append(_placed(ground, post, (2.0, 2.0), anywhere(0.0)))
    for turn_deg in (0.0, 0.0, 180.0, 180.0):
        pose = anywhere(along_deg + turn_deg + draws.between(-30.0, 30.0, 1))
        placed = _placed(ground, {"kind": "pedestrian"}, (0.6, 0.7), pose)
        objects.append(_moving(placed, draws.between(1.0, 2.0, 1)))
    return _content(parameters, objects)


def draw_town(parameters: DensityParameters, key: str) -> Content:
    """Draw vehicles, pedestrians, posts, rails and hedges."""
    draws = Sampler(key)
    return _content(parameters, _mixed(draws, _free_ground(), parameters.density))


def draw_weak(parameters: WeakParameters, key: str) -> Content:
    """Draw a town whose objects have amplitudes up to 1, uniform in dB over the dynamic range."""
    draws = Sampler(key)
    objects = _mixed(draws, _free_ground(), parameters.density)
    for entry in objects:
        entry["amplitude"] = round(10 ** (-parameters.dynamic_range_db / 20 * draws.uniform()), 4)
    return _content(parameters, objects)


def draw_facade(parameters: DensityParameters, key: str) -> Content:
    """Draw one or two house fronts, and vehicles and pedestrians between them and the base station."""
    draws, ground = Sampler(key), _free_ground()
    objects = []
    for _ in range(2 if parameters.density == "high" else 1):
        length_m, height_m = draws.between(10.0, 18.0, 1), draws.between(4.0, 8.0, 1)

        def pose(half_m: float = length_m / 2) -> Pose:
            yaw_deg = 90.0 + draws.between(-20.0, 20.0, 1)
            return draws.between(half_m, 40.0 - half_m), draws.between(1.0, 8.0), yaw_deg

        front = {"kind": "wall", "size_m": [length_m, height_m]}
        objects.append(_placed(ground, front, (0.2, length_m), pose))

    def before() -> tuple[float, float]:
        return draws.between(0.0, 40.0), draws.between(12.0, 30.0)

    ranges = RANGES[parameters.density]
    objects += [_vehicle(draws, ground, before) for _ in range(draws.whole(*ranges["vehicle"]))]
    objects += [_pedestrian(draws, ground, before) for _ in range(draws.whole(*ranges["pedestrian"]))]
    return _content(parameters, objects)


def draw_crowd(parameters: CrowdParameters, key: str) -> Content:
    """Draw pedestrians who walk in all directions."""
    draws, ground = Sampler(key), _free_ground()
    n = parameters.pedestrians or draws.whole(8, 16)
    anywhere = _anywhere(draws)
    return _content(parameters, [_pedestrian(draws, ground, anywhere) for _ in range(n)])


def draw_sparse(parameters: SparseParameters, key: str) -> Content:
    """Draw lone scatterers, each a Rayleigh cell from every other in range, velocity, u or w.

    Directions differ by a cell in both frames. Scatterers move along the line of sight.

    Raises
    ------
    InputError
        If there is no room for so many.
    """
    draws = Sampler(key)
    n = parameters.scatterers or draws.whole(1, 20)
    region = SQUARE["region"]
    objects: list[Content] = []
    cells = np.empty((0, 6))
    tries = 0
    while len(objects) < n:
        tries += 1
        if tries > MOST_TRIES:
            raise InputError(f"no room for more than {len(objects)} scatterers; allowed are fewer")
        limits = region["x_m"], region["y_m"], LONE_Z_M
        place = [draws.between(low, high, decimals=3) for low, high in limits]
        speed_mps = draws.between(-15.0, 15.0, 3)
        cell = _rayleigh_coordinates(place, speed_mps)
        apart = np.abs(cells - cell) >= 1
        # Range or velocity, or a direction in either frame.
        if (apart[:, :2].any(axis=1) | (apart[:, 2:4].any(axis=1) & apart[:, 4:].any(axis=1))).all():
            cells = np.vstack([cells, cell])
            objects.append({"kind": "point", "position_m": place, "velocity_mps": speed_mps})
            tries = 0
    return _content(parameters, objects)


LANE_M = 3.5
LANES = 4


def draw_traffic(parameters: StreetParameters, key: str) -> Content:
    """Draw a road of four lanes: lorries, vehicles and cyclists both ways, pedestrians beside them."""
    draws, ground = Sampler(key), _free_ground()
    # Traffic keeps right: seen along +x, the first two lanes go there.
    along_deg = draws.between(-25.0, 25.0, 1)
    centre = draws.between(15.0, 25.0), draws.between(12.0, 18.0)

    def on_lane(lane: int, beside_m: float = 0.0) -> Callable[[], Pose]:
        across_m = (lane - (LANES - 1) / 2) * LANE_M
        across_m += math.copysign(beside_m, across_m)
        turn_deg = along_deg - 90.0 + (0.0 if lane < LANES // 2 else 180.0)

        def pose() -> Pose:
            along_m = draws.between(-22.0, 22.0)
            x, y = _along(centre, along_deg, along_m, across_m + draws.between(-0.3, 0.3))
            return x, y, turn_deg + draws.between(-3.0, 3.0, 1)

        return pose

    lanes = [draws.whole(0, LANES - 1) for _ in range(draws.whole(1, 2))]
    objects = [_lorry(draws, ground, on_lane(lane)) for lane in lanes]
    for _ in range(draws.whole(2, 4)):
        objects.append(_car(draws, ground, on_lane(draws.whole(0, LANES - 1))))
    for _ in range(draws.whole(1, 3)):
        objects.append(_cyclist(draws, ground, on_lane(draws.either() * (LANES - 1), 1.4)))
    for _ in range(draws.whole(0, 3)):
        walks = on_lane(draws.either() * (LANES - 1), 3.5)
        placed = _placed(ground, _walker(draws), (0.6, 0.7), walks)
        objects.append(_moving(placed, draws.between(0.5, 2.0, 1)))
    return _content(parameters, objects)


def _along(centre: Place, along_deg: float, along_m: float, across_m: float) -> Place:
    """Place beside a line through a centre."""
    cos, sin = math.cos(math.radians(along_deg)), math.sin(math.radians(along_deg))
    x = centre[0] + cos * along_m - sin * across_m
    return round(x, 2), round(centre[1] + sin * along_m + cos * across_m, 2)


def draw_crossing(parameters: StreetParameters, key: str) -> Content:
    """Draw vehicles, of which every third one turns, cyclists and pedestrians with any heading."""
    draws, ground = Sampler(key), _free_ground()
    anywhere = _anywhere(draws)
    makers: list[tuple[Callable[..., Content], tuple[int, int]]] = [
        (_lorry, (0, 1)),
        (_vehicle, (2, 3)),
        (_cyclist, (2, 4)),
        (_pedestrian, (3, 6)),
    ]
    objects = []
    for make, (least, most) in makers:
        pose = anywhere if make in (_vehicle, _pedestrian) else _turned(draws, anywhere)
        objects += [make(draws, ground, pose) for _ in range(draws.whole(least, most))]
    return _content(parameters, objects)


def _rayleigh_coordinates(place: list[float], speed_mps: float) -> np.ndarray:
    """Range, velocity, and u and w in both frames, in Rayleigh cells."""
    system, (n_p, n_q) = System(), VirtualArray().shape
    offset_m = np.array([place]) - SQUARE["base_station"]["position_m"]
    directions = [get_frame(name).direction_cosines(offset_m) for name in ("panel", "paper")]
    range_m = float(np.linalg.norm(offset_m))
    cosines = [part for u, w in directions for part in (u[0] * n_p / 2, w[0] * n_q / 2)]
    return np.array([range_m / system.range_bin_m, speed_mps / system.velocity_bin_mps, *cosines])


def _content(parameters: StreetParameters, objects: list[Content]) -> Content:
    """Content of a scenario file."""
    of_array = {"gain_error_db", "phase_error_deg", "mimo", "leakage_db"}
    return {
        **({"visible": "seen"} if parameters.visible == "seen" else {}),
        "system": {"coherent_phase": parameters.coherent_phase},
        "array": {
            "frame": parameters.frame,
            **parameters.model_dump(include=of_array, exclude_defaults=True),
        },
        **SQUARE,
        "objects": objects,
    }


def _free_ground() -> FreeGround:
    return FreeGround(SQUARE["region"]["x_m"], SQUARE["region"]["y_m"])


def _anywhere(draws: Sampler) -> Callable[[], Place]:
    region = SQUARE["region"]
    return lambda: (draws.between(*region["x_m"]), draws.between(*region["y_m"]))


def _mirrored(pose: Pose, mirrored: bool) -> Pose:
    """Pose on the other side of the region's middle."""
    x, y, yaw_deg = pose
    low, high = SQUARE["region"]["x_m"]
    return (low + high - x, y, -yaw_deg) if mirrored else pose


def _placed(
    ground: FreeGround, entry: Content, footprint_m: tuple[float, float], pose: Callable[[], Pose]
) -> Content:
    """Entry of an object with its place and its heading."""
    x, y, yaw_deg = ground.place(footprint_m, pose)
    yaw_deg = round(math.remainder(yaw_deg, 360.0), 1)
    return {**entry, "position_m": [round(x, 2), y, 0.0], "yaw_deg": yaw_deg, "velocity_mps": [0.0, 0.0, 0.0]}


def _moving(entry: Content, speed_mps: float) -> Content:
    """Entry of an object that moves forwards."""
    velocity = (speed_mps * heading(entry["yaw_deg"])).round(6) + 0.0
    return {**entry, "velocity_mps": velocity.tolist()}


def _mixed(draws: Sampler, ground: FreeGround, density: str) -> list[Content]:
    """Objects of a town; the largest find their places first."""
    ranges = RANGES[density]
    numbers = {kind: draws.whole(*ranges[kind]) for kind in ranges}
    anywhere = _anywhere(draws)
    makers: dict[str, Callable[..., Content]] = {
        "rail": _rail,
        "hedge": _hedge,
        "vehicle": _vehicle,
        "pole": _pole,
        "pedestrian": _pedestrian,
    }
    return [make(draws, ground, anywhere) for kind, make in makers.items() for _ in range(numbers[kind])]


def _turned(draws: Sampler, place: Callable[[], Place]) -> Callable[[], Pose]:
    """Draws of a place and any heading."""
    return lambda: (*place(), draws.between(-180.0, 180.0, 1))


def _rail(draws: Sampler, ground: FreeGround, place: Callable[[], Place]) -> Content:
    length_m = draws.between(5.0, 12.0, 1)
    return _placed(ground, {"kind": "rail", "length_m": length_m}, (0.2, length_m), _turned(draws, place))


def _hedge(draws: Sampler, ground: FreeGround, place: Callable[[], Place]) -> Content:
    width_m, length_m = draws.between(0.8, 1.1, 1), draws.between(3.0, 8.0, 1)
    entry = {"kind": "box", "size_m": [width_m, length_m, draws.between(0.8, 1.1, 1)]}
    return _placed(ground, entry, (width_m, length_m), _turned(draws, place))


def _pole(draws: Sampler, ground: FreeGround, place: Callable[[], Place]) -> Content:
    entry = {"kind": "pole", "height_m": draws.between(3.0, 9.0, 1)}
    return _placed(ground, entry, (0.3, 0.3), _turned(draws, place))


def _vehicle(draws: Sampler, ground: FreeGround, place: Callable[[], Place]) -> Content:
    """Vehicle that drives, every third one through a bend."""
    entry = _body(draws)
    speed_mps = draws.between(2.0, FASTEST_MPS, 1)
    yaw_rate_dps = draws.between(-30.0, 30.0, 1) if draws.whole(1, 3) == 1 else 0.0
    entry["yaw_rate_dps"] = yaw_rate_dps
    return _moving(_placed(ground, entry, _footprint(entry), _turned(draws, place)), speed_mps)


def _car(draws: Sampler, ground: FreeGround, pose: Callable[[], Pose]) -> Content:
    """Vehicle in a pose that drives straight on."""
    entry = _body(draws)
    return _moving(_placed(ground, entry, _footprint(entry), pose), draws.between(3.0, FASTEST_MPS, 1))


def _body(draws: Sampler) -> Content:
    """Vehicle of any size."""
    # No height between: 0.7 m of a cabin cannot be divided into steps of 0.5 m ± 20 %.
    height_m = draws.between(1.4, 1.5, 1) if draws.either() else draws.between(1.7, 1.9, 1)
    return {"kind": "vehicle", "size_m": [draws.between(1.6, 2.0, 1), draws.between(3.8, 5.6, 1), height_m]}


def _footprint(entry: Content) -> tuple[float, float]:
    width_m, length_m, _ = entry["size_m"]
    return width_m, length_m


def _lorry(draws: Sampler, ground: FreeGround, pose: Callable[[], Pose]) -> Content:
    size_m = [draws.between(2.3, 2.6, 1), draws.between(7.0, 11.0, 1), draws.between(3.2, 4.0, 1)]
    entry = {"kind": "lorry", "size_m": size_m}
    return _moving(_placed(ground, entry, _footprint(entry), pose), draws.between(2.0, 10.0, 1))


def _cyclist(draws: Sampler, ground: FreeGround, pose: Callable[[], Pose]) -> Content:
    entry = {"kind": "cyclist", "crank_phase_deg": draws.between(0.0, 359.0, 0)}
    return _moving(_placed(ground, entry, (0.6, 1.8), pose), draws.between(2.0, 8.0, 1))


def _pedestrian(draws: Sampler, ground: FreeGround, place: Callable[[], Place]) -> Content:
    """Pedestrian at some phase of the stride."""
    entry = _walker(draws)
    speed_mps = draws.between(0.5, 2.0, 1)
    return _moving(_placed(ground, entry, (0.6, 0.7), _turned(draws, place)), speed_mps)


def _walker(draws: Sampler) -> Content:
    return {
        "kind": "pedestrian",
        "height_m": draws.between(1.5, 1.9),
        "stride_phase_deg": draws.between(0.0, 359.0, 0),
    }


DRAWS: dict[str, Callable[[Any, str], Content]] = {
    "street": draw_street,
    "town": draw_town,
    "facade": draw_facade,
    "crowd": draw_crowd,
    "weak": draw_weak,
    "sparse": draw_sparse,
    "traffic": draw_traffic,
    "crossing": draw_crossing,
    "uma-av": draw_uma_av,
}


def scene_table(spec: FamilySpec) -> Content:
    """Content of the scenario file of a family's scene, if there is room for the objects."""
    family, parameters = spec.family, spec.parameters
    try:
        content = DRAWS[family.name](parameters, f"{family.name} {family.version} {parameters.seed}")
    except InputError as error:
        raise InputError(f"scenario {spec.name}: {error}") from error
    return {"name": spec.name, **content}
