"""Cases of detectors: levels, dynamic range, constants, odd shapes, windows and rates."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import product

import numpy as np

from isacbench.checking import case
from isacbench.checking import map_checks as checks
from isacbench.checking.case import Choice, Real, Whole, with_parameters
from isacbench.checking.checks import Check
from isacbench.checking.map_checks import EVERY_MAP, MAP_INVARIANT, MapSubject, white_noise_map
from isacbench.plugins.contracts import Detector

MapCase = tuple[MapSubject, Sequence[Check]]

family = partial(case.family, kind="detector")

SHAPE = 13, 17
"""Shape of an ordinary map: primes, and larger than the windows by default."""

MIDDLE = 6, 8

ECHO = 1000.0
"""Power above any threshold in noise of mean 1: so that cells are detected at every rate."""


@family("map_level", product((-76.0, -30.0, 0.0, 30.0, 76.0)), exponent=Real(-76.0, 76.0, 0.0))
def map_level(plugin: Detector, seed: int, exponent: float) -> MapCase:
    """Noise with three echoes at any level, up to the squares of the largest float32."""
    power = np.minimum(white_noise_map(SHAPE, seed), 15.0)
    power[5, 7], power[12, 0], power[0, 16] = 100.0, 40.0, 20.0
    subject = MapSubject(plugin, power * 10.0**exponent)
    return subject, (*EVERY_MAP, *MAP_INVARIANT, checks.MAP_SINGLE_PRECISION)


STRONG = "checkers", "one_cell", "half", "any"


@family(
    "map_range", product((140.0, 300.0), STRONG), range_db=Real(0.0, 300.0, 140.0), strong=Choice(*STRONG)
)
def map_range(plugin: Detector, seed: int, range_db: float, strong: str) -> MapCase:
    """Noise whose cells are up to 300 dB stronger than their neighbours."""
    share = np.random.default_rng([seed, 1]).random(SHAPE) if strong == "any" else np.zeros(SHAPE)
    checkers = np.indices(SHAPE).sum(axis=0) % 2 == 1
    filled = {"checkers": checkers, "one_cell": MIDDLE, "half": np.s_[:, 9:]}
    if strong in filled:
        share[filled[strong]] = 1.0
    power = white_noise_map(SHAPE, seed) * 10.0 ** (range_db / 10 * (share - 0.5))
    return MapSubject(plugin, power), (*EVERY_MAP, *MAP_INVARIANT)


@family(
    "blank_map",
    [("zeros",), *product(("constant",), (-76.0, -0.3, 0.0, 76.0)), ("one_cell",), ("few_cells",)],
    filled=Choice("zeros", "constant", "one_cell", "few_cells"),
    exponent=Real(-76.0, 76.0, 0.0),
)
def blank_map(plugin: Detector, seed: int, filled: str, exponent: float) -> MapCase:
    """Zeros, the same power in every cell, or zeros but for one cell or for every seventh."""
    power = np.zeros(SHAPE)
    every_seventh = np.arange(power.size).reshape(SHAPE) % 7 == 0
    cells = {"zeros": [], "constant": np.s_[:], "one_cell": MIDDLE, "few_cells": every_seventh}
    power[cells[filled]] = 10.0**exponent
    nothing = (checks.NOTHING,) if filled in ("zeros", "constant") else ()
    return MapSubject(plugin, power), (*EVERY_MAP, *nothing, checks.MAP_TWO_POWER_SCALE)


@family(
    "map_window",
    [
        *((1, 3, 17, 1, 0), (1, 9, 17, 3, 1), (1, 8, 17, 3, 1)),
        *((2, 1, 1, 1, 0), (2, 9, 9, 3, 1), (2, 9, 8, 3, 1), (2, 37, 11, 3, 2), (2, 13, 17, 20, 3)),
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
    return MapSubject(detector, white_noise_map(shape, seed)), EVERY_MAP if is_whole else (checks.REFUSED,)


@family(
    "rate",
    [(-15.0, 1), (-15.0, 1024), (-2.0, 1), (-3.0, 256), (-0.31, 1), (-0.31, 16)],
    exponent=Real(-15.0, -0.31, -3.0),
    looks=Whole(1, 1024, 1),
)
def rate(plugin: Detector, seed: int, exponent: float, looks: int) -> MapCase:
    """Any probability of false alarm, and any number of looks."""
    power = white_noise_map((9, 11), seed, looks)
    power[0, 0] = ECHO  # in a corner that half of the windows do not reach
    subject = MapSubject(with_parameters(plugin, pfa=10.0**exponent), power, looks)
    return subject, (*EVERY_MAP, *MAP_INVARIANT, checks.FALSE_ALARM_RATE, checks.RATE_ORDER)
