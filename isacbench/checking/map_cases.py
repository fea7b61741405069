"""Cases of detectors: levels, dynamic range, constants, odd shapes, windows and rates."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from isacbench.checking import case
from isacbench.checking.case import Choice, Real, Whole, grid, with_parameters
from isacbench.checking.checks import Check
from isacbench.checking.map_checks import (
    EVERY_MAP,
    FALSE_ALARM_RATE,
    MAP_INVARIANT,
    MAP_SINGLE_PRECISION,
    MAP_TWO_POWER_SCALE,
    NOTHING,
    RATE_ORDER,
    REFUSED,
    MapSubject,
    white_noise_map,
)
from isacbench.plugins.contracts import Detector

MapCase = tuple[MapSubject, Sequence[Check[MapSubject]]]

family = partial(case.family, kind="detector")

SHAPE = 13, 17
"""Shape of an ordinary map: primes, and larger than the windows by default."""

ECHO = 1000.0
"""Power above any threshold in noise of mean 1: so that cells are detected at every rate."""


@family("map_level", grid(exponent=(-76.0, -30.0, 0.0, 30.0, 76.0)), exponent=Real(-76.0, 76.0, 0.0))
def map_level(plugin: Detector, seed: int, exponent: float) -> MapCase:
    """Noise with three echoes at any level, up to the squares of the largest float32."""
    power = np.minimum(white_noise_map(SHAPE, seed), 15.0)
    power[5, 7], power[12, 0], power[0, 16] = 100.0, 40.0, 20.0
    checks = (*EVERY_MAP, *MAP_INVARIANT, MAP_SINGLE_PRECISION)
    return MapSubject(plugin, power * 10.0**exponent), checks


STRONG = "checkers", "one_cell", "half", "any"


@family(
    "map_range",
    grid(range_db=(140.0, 300.0), strong=STRONG),
    range_db=Real(0.0, 300.0, 140.0),
    strong=Choice(*STRONG),
)
def map_range(plugin: Detector, seed: int, range_db: float, strong: str) -> MapCase:
    """Noise whose cells are up to 300 dB stronger than their neighbours."""
    share = np.zeros(SHAPE)
    match strong:
        case "checkers":
            share[np.indices(SHAPE).sum(axis=0) % 2 == 1] = 1.0
        case "one_cell":
            share[6, 8] = 1.0
        case "half":
            share[:, 9:] = 1.0
        case "any":
            share = np.random.default_rng([seed, 1]).random(SHAPE)
    power = white_noise_map(SHAPE, seed) * 10.0 ** (range_db / 10 * (share - 0.5))
    return MapSubject(plugin, power), (*EVERY_MAP, *MAP_INVARIANT)


@family(
    "blank_map",
    [
        {"filled": "zeros"},
        *grid(filled=("constant",), exponent=(-76.0, -0.3, 0.0, 76.0)),
        {"filled": "one_cell"},
        {"filled": "few_cells"},
    ],
    filled=Choice("zeros", "constant", "one_cell", "few_cells"),
    exponent=Real(-76.0, 76.0, 0.0),
)
def blank_map(plugin: Detector, seed: int, filled: str, exponent: float) -> MapCase:
    """Zeros, the same power in every cell, or zeros but for one cell or for every seventh."""
    power = np.zeros(SHAPE)
    match filled:
        case "constant":
            power[:] = 10.0**exponent
        case "one_cell":
            power[6, 8] = 10.0**exponent
        case "few_cells":
            power.flat[::7] = 10.0**exponent
    nothing = (NOTHING,) if filled in ("zeros", "constant") else ()
    return MapSubject(plugin, power), (*EVERY_MAP, *nothing, MAP_TWO_POWER_SCALE)


@family(
    "map_window",
    [
        {"n_axes": 1, "length": 3, "training": 1, "guard": 0},
        {"n_axes": 1, "length": 9, "training": 3, "guard": 1},
        {"n_axes": 1, "length": 8, "training": 3, "guard": 1},
        {"n_axes": 2, "length": 1, "width": 1, "training": 1, "guard": 0},
        {"n_axes": 2, "length": 9, "width": 9, "training": 3, "guard": 1},
        {"n_axes": 2, "length": 9, "width": 8, "training": 3, "guard": 1},
        {"n_axes": 2, "length": 37, "width": 11, "training": 3, "guard": 2},
        {"n_axes": 2, "length": 13, "width": 17, "training": 20, "guard": 3},
    ],
    n_axes=Choice(2, 1),
    length=Whole(1, 41, 13),
    width=Whole(1, 41, 17),
    training=Whole(1, 20, 3),
    guard=Whole(0, 3, 1),
)
def map_window(
    plugin: Detector, seed: int, n_axes: int, length: int, width: int, training: int, guard: int
) -> MapCase:
    """Lines and maps of any size, and windows that fit them, just or not at all."""
    shape = (length, width)[:n_axes]
    detector = with_parameters(plugin, training=training, guard=guard)
    is_whole = 2 * (training + guard) + 1 <= min(shape)
    return MapSubject(detector, white_noise_map(shape, seed)), EVERY_MAP if is_whole else (REFUSED,)


RATES = (-15.0, 1), (-15.0, 1024), (-2.0, 1), (-3.0, 256), (-0.31, 1), (-0.31, 16)


@family(
    "rate",
    [{"exponent": exponent, "looks": looks} for exponent, looks in RATES],
    exponent=Real(-15.0, -0.31, -3.0),
    looks=Whole(1, 1024, 1),
)
def rate(plugin: Detector, seed: int, exponent: float, looks: int) -> MapCase:
    """Any probability of false alarm, and any number of looks."""
    power = white_noise_map((9, 11), seed, looks)
    power[0, 0] = ECHO  # in a corner that half of the windows do not reach
    detector = with_parameters(plugin, pfa=10.0**exponent)
    checks = (*EVERY_MAP, *MAP_INVARIANT, FALSE_ALARM_RATE, RATE_ORDER)
    return MapSubject(detector, power, looks), checks
