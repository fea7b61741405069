"""Cases of estimators and detectors: levels, echoes, edges of sight, odd radios, maps, windows and rates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isacbench.checking import image_checks as images
from isacbench.checking import map_checks as maps
from isacbench.checking import scenes
from isacbench.checking.checks import Check, Choice, Real, Subject, Whole, family, with_parameters
from isacbench.checking.image_checks import EVERY, FOUND, INVARIANT, LEAKAGE, RESOLVED_ECHOES, ImageSubject
from isacbench.checking.map_checks import EVERY_MAP, MAP_INVARIANT, MapSubject, white_noise_map
from isacbench.checking.scenes import REGION, RESOLVED, SYSTEM, Echo, Layout, observed
from isacbench.model.echo import Simulator, central_phase, random_stream
from isacbench.model.frame import PanelFrame, PaperFrame
from isacbench.model.numerology import System
from isacbench.model.region import Region
from isacbench.plugins.contracts import Detector, Estimator

ImageCase = tuple[ImageSubject, Sequence[Check]]
MapCase = tuple[MapSubject, Sequence[Check]]

image_family = partial(family, kind="estimator")
map_family = partial(family, kind="detector")

SNR_DB = {"none": math.inf, "20dB": 20.0}
"""SNR by the word for the noise."""

NOISE = Choice(*SNR_DB)

# Levels: noise, amplitudes, dynamic range, rates, precision, and cells of one value.

CLEAR_DB = 60.0
"""SNR from which noise excuses neither a false point nor a wrong power."""

SEEN_DB = 0.0
"""SNR from which every echo is seen."""

FOUND_DB = 10.0
"""Level below the strongest echo down to which every estimator is expected to see a resolved one."""


@image_family(product((-80.0, -10.0, 0.0, 20.0, 60.0, 200.0)), snr_db=Real(-80.0, 200.0, 20.0))
def snr(plugin: Estimator, seed: int, snr_db: float) -> ImageCase:
    """Three resolved echoes at any SNR."""
    found = (FOUND,) if snr_db >= SEEN_DB else ()
    clear = (images.NO_FALSE_POINT, images.POWER) if snr_db >= CLEAR_DB else ()
    return ImageSubject(plugin, observed(RESOLVED, snr_db, seed)), (*EVERY, *found, *clear, *INVARIANT)


@image_family(
    [(-30.0, "none"), (30.0, "none"), (30.0, "weak")],
    exponent=Real(-30.0, 30.0, 0.0),
    noise=Choice("none", "weak"),
)
def amplitude(plugin: Estimator, seed: int, exponent: float, noise: str) -> ImageCase:
    """Three resolved echoes of any amplitude that float32 holds, without noise or far above it."""
    echoes = [echo._replace(amplitude=10.0**exponent) for echo in RESOLVED]
    scene = observed(echoes, math.inf if noise == "none" else CLEAR_DB, seed)
    return ImageSubject(plugin, scene), (*EVERY, *RESOLVED_ECHOES, images.POWER, *INVARIANT)


WEAK_BINS = {"own_cell": (0, 0), "next_range": (1, 0), "next_doppler": (0, 1), "far": (-4, -4)}
"""Bins from the strong echo to the weak one."""


@image_family(
    [(level_db, where) for where in WEAK_BINS for level_db in (3.0, 60.0, 140.0)],
    level_db=Real(0.0, 140.0, 20.0),
    where=Choice(*WEAK_BINS),
)
def dynamic_range(plugin: Estimator, seed: int, level_db: float, where: str) -> ImageCase:
    """An echo, and a weaker one in its own cell, in a neighbouring one or far away; no noise."""
    strong, bins = RESOLVED[1], WEAK_BINS[where]
    weak = strong._replace(
        range_bin=strong.range_bin + bins[0],
        doppler_bin=strong.doppler_bin + bins[1],
        u=strong.u - 0.8,
        w=strong.w + 0.7,
        amplitude=10 ** (-level_db / 20),
    )
    both = (FOUND,) if level_db <= FOUND_DB and where == "far" else ()
    scene = observed([strong, weak], seed=seed)
    return ImageSubject(plugin, scene), (*EVERY, images.NO_FALSE_POINT, images.FOUND_FIRST, *both, *INVARIANT)


@image_family(product((-15.0, -0.302), SNR_DB), exponent=Real(-15.0, -0.302, -3.0), noise=NOISE)
def pfa(plugin: Estimator, seed: int, exponent: float, noise: str) -> ImageCase:
    """Resolved echoes at any probability of false alarm."""
    estimator = with_parameters(plugin, pfa=10.0**exponent)
    scene = observed(RESOLVED, SNR_DB[noise], seed)
    return ImageSubject(estimator, scene), (*EVERY, FOUND, *INVARIANT)


@image_family(product((0.0, 20.0, 140.0)), snr_db=Real(0.0, 200.0, 20.0))
def single_precision(plugin: Estimator, seed: int, snr_db: float) -> ImageCase:
    """Resolved echoes in single precision."""
    return ImageSubject(plugin, observed(RESOLVED, snr_db, seed)), (*EVERY, FOUND, images.SINGLE_PRECISION)


FILLED = "constant", "one_cell", "one_element", "checkers", "loud_element"


@image_family(
    [("zeros",), *product(FILLED, (-30.0, 30.0))],
    filled=Choice("zeros", *FILLED),
    exponent=Real(-30.0, 30.0, 0.0),
)
def map_(plugin: Estimator, seed: int, filled: str, exponent: float) -> ImageCase:
    """Cells of one value, or zeros but for a cell, an element or every second cell."""
    scene = observed([], 0.0, seed, Layout(region=scenes.NARROW))
    noise = scene.observation.cells
    cells = noise.copy() if filled == "loud_element" else np.zeros_like(noise)
    middle = cells.shape[0] // 2, cells.shape[1] // 2
    where = {
        "zeros": [],
        "constant": np.s_[:],
        "one_cell": middle,
        "checkers": np.indices(cells.shape[:2]).sum(axis=0) % 2 == 0,
    }
    cells[where.get(filled, (*middle, 1, 1))] = 10.0**exponent
    nothing = (images.NO_FALSE_POINT,) if filled == "zeros" else ()
    return ImageSubject(plugin, scene.with_cells(cells)), (*EVERY, *nothing, *LEAKAGE)


# A ladder of SNRs.

STEPS_DB = 5.0
N_STEPS = 8
START_DB = -25.0


@image_family(
    [(START_DB, "one"), (START_DB, "three"), (20.0, "three")],
    from_db=Real(-40.0, 100.0, START_DB),
    echoes=Choice("one", "three"),
)
def ladder(plugin: Estimator, seed: int, from_db: float, echoes: str) -> tuple[Subject, Sequence[Check]]:
    """One resolved echo, or three, at rising SNR: the error falls, within its confidence interval."""
    scenario = scenes.scenario_of(RESOLVED[:1] if echoes == "one" else RESOLVED)
    levels_db = tuple(from_db + STEPS_DB * step for step in range(N_STEPS))
    small = () if from_db < START_DB else (images.SMALL_AT_LAST,)
    return images.LadderSubject(plugin, Simulator(scenario), levels_db, seed), (images.FALLS, *small)


# Few and many: pairs that the radio cannot tell apart, coherent sources, thousands.

RAYLEIGH_COSINE = 0.25
"""Rayleigh cell of the array of 8 x 8 elements, in a direction cosine."""

CELL = np.array([1.0, 1.0, RAYLEIGH_COSINE, RAYLEIGH_COSINE])
"""Rayleigh cell in range bins, Doppler bins, u and w."""

STEPS = dict(zip(("range", "doppler", "u", "w", "all"), (*np.eye(4), np.ones(4)), strict=True))
"""Directions in which two close echoes are apart."""

CANCELLING = 0.9
"""Half turns between two echoes from which hardly anything is left of them."""

UNEQUAL = 0.9
"""Ratio of the amplitudes of successive echoes: equal ones in phase have no order."""

LOWEST_SPREAD, HIGHEST_SPREAD = np.array([3.0, -4.0, -0.55, -0.55]), np.array([13.0, 4.0, 0.55, 0.55])
SPREAD_CELLS = 3.0
"""Cells between any two echoes, in range, speed or a direction."""


@image_family(product((0.0, 0.5, 1.0), SNR_DB), half_turns=Real(0.0, 1.0, 0.0), noise=NOISE)
def pair(plugin: Estimator, seed: int, half_turns: float, noise: str) -> ImageCase:
    """Two echoes in one place, of any phase; at half a turn they cancel."""
    one, is_clear = RESOLVED[0], noise == "none"
    scene = observed([one, one._replace(phase_rad=math.pi * half_turns)], SNR_DB[noise], seed)
    if half_turns > CANCELLING:
        nothing = (images.NO_POINT,) if is_clear and half_turns == 1 else ()
        return ImageSubject(plugin, scene), (*EVERY, *nothing)
    clear = (images.NO_FALSE_POINT,) if is_clear else ()
    return ImageSubject(plugin, scene), (*EVERY, *clear, FOUND, *INVARIANT)


@image_family(
    [(exponent, along) for along in STEPS for exponent in (-1.0, -3.0, -9.0)],
    exponent=Real(-12.0, -1.0, -6.0),
    along=Choice(*STEPS),
)
def close(plugin: Estimator, seed: int, exponent: float, along: str) -> ImageCase:
    """Two echoes closer than any cell, in phase at the centre of the frame and of the array; no noise."""
    one = RESOLVED[0]
    place = one[:4] + 10.0**exponent * CELL * STEPS[along]
    echoes = _in_phase([one, Echo(*place.tolist())._replace(amplitude=UNEQUAL)])
    return ImageSubject(plugin, observed(echoes, seed=seed)), (*EVERY, *RESOLVED_ECHOES, *INVARIANT)


@image_family(product((2, 3), (0.3, 0.6, 1.0, 1.5)), n_echoes=Whole(2, 6, 2), separation=Real(0.0, 2.0, 1.0))
def coherent(plugin: Estimator, seed: int, n_echoes: int, separation: float) -> ImageCase:
    """Echoes of one range and one speed, exactly coherent, in a row over directions; no noise."""
    step = separation * RAYLEIGH_COSINE
    middle = (n_echoes - 1) / 2
    echoes = [
        Echo(9.2, 1.3, (k - middle) * step * 0.8, 0.1 + (k - middle) * step * 0.6, UNEQUAL**k)
        for k in range(n_echoes)
    ]
    scene = observed(_in_phase([echo for echo in echoes if math.hypot(echo.u, echo.w) < 1]), seed=seed)
    resolved = (images.NO_FALSE_POINT,) if separation >= 1.5 and n_echoes <= 3 else ()
    return ImageSubject(plugin, scene), (*EVERY, *resolved, *INVARIANT)


CROWDS = {"region": ((3.0, -4.0), (13.0, 4.0)), "one_cell": ((8.8, 0.8), (9.2, 1.2))}
"""Lowest and highest range and Doppler bins of a crowd."""


@image_family(
    [(n, where, snr_db) for where in CROWDS for n, snr_db in ((12, 20.0), (100, 200.0), (5000, 20.0))],
    n_echoes=Whole(1, 5000, 100),
    where=Choice(*CROWDS),
    snr_db=Real(-20.0, 200.0, 20.0),
)
def crowd(plugin: Estimator, seed: int, n_echoes: int, where: str, snr_db: float) -> ImageCase:
    """Many echoes, in one cell or everywhere."""
    # Its specification seeds its draws.
    stream = random_stream("stress", 0, seed, crowd.case(n_echoes=n_echoes, where=where, snr_db=snr_db).spec)
    bins = stream.uniform(*CROWDS[where], (n_echoes, 2))
    radius = 0.8 * np.sqrt(stream.uniform(size=n_echoes))
    angle = stream.uniform(0, 2 * np.pi, n_echoes)
    phase = stream.uniform(0, 2 * np.pi, n_echoes)
    places = np.column_stack([bins, radius * np.cos(angle), radius * np.sin(angle)])
    return ImageSubject(plugin, observed(_unit_echoes(places, phase), snr_db, seed)), EVERY


@image_family(
    [
        *product((2, 4, 8), (0, 1)),
        # Found by search: a spectrum's pole that a sample struck hid the other source of the cell.
        *((2, 147), (2, 1785), (8, 192)),
    ],
    n_echoes=Whole(1, 10, 4),
    draw=Whole(0, 9999, 0),
)
def spread(plugin: Estimator, seed: int, n_echoes: int, draw: int) -> ImageCase:
    """Equal echoes at random places of which no two share a cell; no noise."""
    stream = random_stream("stress", draw, seed, "spread")
    places: list[NDArray[np.float64]] = []
    while len(places) < n_echoes:
        place = stream.uniform(LOWEST_SPREAD, HIGHEST_SPREAD)
        if all((np.abs(place - other) / CELL).max() >= SPREAD_CELLS for other in places):
            places.append(place)
    phase = stream.uniform(0, 2 * np.pi, n_echoes)
    scene = observed(_unit_echoes(places, phase), seed=seed)
    return ImageSubject(plugin, scene), (*EVERY, *RESOLVED_ECHOES, *INVARIANT)


def _unit_echoes(places: ArrayLike, phase_rad: NDArray[np.float64]) -> list[Echo]:
    """Echoes of amplitude 1 at places (n, 4): bins and direction cosines."""
    return [Echo(*row) for row in np.column_stack([places, np.ones_like(phase_rad), phase_rad]).tolist()]


def _in_phase(echoes: list[Echo]) -> list[Echo]:
    """Echoes with such phases that they are equal at the centre of the frame and of the array.

    That is where echoes closer than a Rayleigh cell are hardest to tell apart.
    """
    phases = central_phase(scenes.scenario_of(echoes))
    return [
        echo._replace(phase_rad=echo.phase_rad - float(phase))
        for echo, phase in zip(echoes, phases, strict=True)
    ]


# Places: on bins and between them, at the edges of sight, and beyond what is unambiguous.

FOUND_RADIUS = 0.98
"""Distance from straight ahead, in direction cosines, up to which an echo is promised to be found: 78.5°."""

FARTHEST_M = REGION.range_limits_m(np.array(scenes.BASE_STATION_M))[1]


@image_family(
    [
        *((0.0, 0.0), (0.5, 0.5), (0.49999999, -0.50000001)),
        *((0.5, 0.5, "last_bins"), (1.0, 1.0, "last_bins")),
        *((0.5, -0.5, "whole_map"), (0.0, 0.99, "whole_map")),
    ],
    range_offset=Real(-1.0, 1.0, 0.0),
    doppler_offset=Real(-1.0, 1.0, 0.0),
    where=Choice("middle", "last_bins", "whole_map"),
)
def bin_(plugin: Estimator, seed: int, range_offset: float, doppler_offset: float, where: str) -> ImageCase:
    """One echo at any place relative to the bins: in the middle, in the last bins, in the last of all."""
    region = REGION
    range_bin, doppler_bin, u, w = 10.0, 1.0, 0.2, -0.3
    if where == "last_bins":  # those that the region's speed limit and corner reach
        u = w = (region.x_m[1] - scenes.BASE_STATION_M[0]) / FARTHEST_M
        range_bin = math.floor(FARTHEST_M / SYSTEM.range_bin_m) - 1.0
        doppler_bin = math.floor(region.speed_mps[1] / SYSTEM.velocity_bin_mps) - 1.0
    elif where == "whole_map":
        limit_mps = SYSTEM.unambiguous_speed_mps
        region = Region(region.x_m, region.y_m, region.z_m, (-limit_mps, limit_mps))
        doppler_bin = SYSTEM.n_symbols / 2 - 1.0
    echo = Echo(range_bin + range_offset, doppler_bin + doppler_offset, u, w)
    scene = observed([echo], seed=seed, layout=Layout(region=region))
    return ImageSubject(plugin, scene), (*EVERY, *RESOLVED_ECHOES, images.POWER, *INVARIANT)


@image_family(
    [
        *((0.0,), (1e-12,), (0.3, 30.0), (0.8, 30.0), (0.97, 30.0)),
        *product((FOUND_RADIUS,), (0.0, 90.0, 180.0, 270.0)),
        *((0.999, 0.0), (0.999, 45.0), (0.999, 225.0), (1.0 - 1e-9, 30.0), (1.0, 0.0), (1.0, 90.0)),
    ],
    radius=Real(0.0, 1.0, 0.0),
    angle_deg=Real(0.0, 360.0, 0.0),
)
def direction(plugin: Estimator, seed: int, radius: float, angle_deg: float) -> ImageCase:
    """One echo from any direction, from straight ahead to grazing."""
    angle = math.radians(angle_deg)
    scene = observed([Echo(9.3, 1.2, radius * math.cos(angle), radius * math.sin(angle))], seed=seed)
    # Farther out, the errors of the direction decide on which side of the border it lies.
    inner = (FOUND, *INVARIANT) if radius <= FOUND_RADIUS else ()
    return ImageSubject(plugin, scene), (*EVERY, images.NO_FALSE_POINT, *inner)


BEYOND = "gate", "region", "prefix", "range", "speed"


@image_family(product(BEYOND, SNR_DB), what=Choice(*BEYOND), noise=NOISE, excess=Real(0.0, 1.0, 0.3))
def beyond(plugin: Estimator, seed: int, what: str, noise: str, excess: float) -> ImageCase:
    """An echo in the region, and one beyond the gate, the region, the prefix or an ambiguity."""
    inside = RESOLVED[0]
    farthest_bin = FARTHEST_M / SYSTEM.range_bin_m
    free_bins = SYSTEM.isi_free_range_m / SYSTEM.range_bin_m
    fastest_bin = SYSTEM.n_symbols - 3 + excess
    stray = {
        "gate": inside._replace(range_bin=farthest_bin + 8 + 40 * excess),
        "region": inside._replace(range_bin=farthest_bin + 2 * excess, u=0.0, w=0.0),
        "prefix": inside._replace(range_bin=(1 + excess) * free_bins),
        "range": inside._replace(range_bin=SYSTEM.n_subcarriers + 9 + excess),
        "speed": inside._replace(range_bin=10.0, doppler_bin=fastest_bin, u=0.4, w=-0.4),
    }[what]
    scene = observed([inside, stray], SNR_DB[noise], seed)
    # Points of what leaks in from beyond the gate, which is no echo of the model, may move with the last
    # digits.
    invariant = LEAKAGE if what == "gate" else INVARIANT
    return ImageSubject(plugin, scene), (*EVERY, images.FOUND_FIRST, *invariant)


# Radios: arrays, numerologies and frames.

SMALLEST_MAP = 11
"""Bins along an axis below which a taper or a detector's window need not fit."""


@image_family([(2, 2), (2, 32), (32, 2), (3, 7), (16, 16), (31, 9)], n_u=Whole(2, 32, 8), n_w=Whole(2, 32, 8))
def array(plugin: Estimator, seed: int, n_u: int, n_w: int) -> ImageCase:
    """One echo without noise, seen by any array."""
    layout = Layout(array=(n_u, n_w), region=scenes.NARROW)
    scene = observed([Echo(9.3, 0.7, 0.05, -0.08)], seed=seed, layout=layout)
    return ImageSubject(plugin, scene), (*EVERY, *RESOLVED_ECHOES, *INVARIANT)


@image_family(
    [(1, 1), (1, 32), (2, 2), (64, 1), (251, 31), (97, 13), (1021, 61)],
    n_subcarriers=Whole(1, 1024, 256),
    n_symbols=Whole(1, 64, 32),
    noise=NOISE,
)
def numerology(plugin: Estimator, seed: int, n_subcarriers: int, n_symbols: int, noise: str) -> ImageCase:
    """Two echoes, with any number of subcarriers and of symbols: prime, odd, even, one."""
    system = System(n_subcarriers=n_subcarriers, n_symbols=n_symbols)
    echoes = [  # from 22 m, and from 25 m and moving
        Echo(22.0 / system.range_bin_m, 0.0, 0.1, -0.1),
        Echo(25.0 / system.range_bin_m, 15.0 / system.velocity_bin_mps, -0.15, 0.15),
    ]
    both = (FOUND,) if min(n_subcarriers / 8, n_symbols) >= SMALLEST_MAP else ()
    scene = observed(echoes, SNR_DB[noise], seed, Layout(system, region=scenes.NARROW))
    may_refuse = min(n_subcarriers, n_symbols) < SMALLEST_MAP
    return ImageSubject(plugin, scene, may_refuse=may_refuse), (*EVERY, *both, *INVARIANT)


FRAMES: dict[str, Any] = {"paper": PaperFrame(), "turned_panel": PanelFrame(yaw_deg=11.0, tilt_deg=-7.0)}


@image_family(product(FRAMES), frame=Choice(*FRAMES))
def frame(plugin: Estimator, seed: int, frame: str) -> ImageCase:
    """Resolved echoes in the paper's frame or on a turned panel."""
    layout = Layout(frame=FRAMES[frame], region=scenes.PAPER_REGION)
    scene = observed(RESOLVED[::2], seed=seed, layout=layout)
    return ImageSubject(plugin, scene), (*EVERY, *RESOLVED_ECHOES, *INVARIANT)


# Power maps.

SHAPE = 13, 17
"""Shape of an ordinary map: primes, and larger than the windows by default."""

MIDDLE = 6, 8

ECHO = 1000.0
"""Power above any threshold in noise of mean 1: so that cells are detected at every rate."""


@map_family(product((-76.0, -30.0, 0.0, 30.0, 76.0)), exponent=Real(-76.0, 76.0, 0.0))
def map_level(plugin: Detector, seed: int, exponent: float) -> MapCase:
    """Noise with three echoes at any level, up to the squares of the largest float32."""
    power = np.minimum(white_noise_map(SHAPE, seed), 15.0)
    power[5, 7], power[12, 0], power[0, 16] = 100.0, 40.0, 20.0
    subject = MapSubject(plugin, power * 10.0**exponent)
    return subject, (*EVERY_MAP, *MAP_INVARIANT, maps.MAP_SINGLE_PRECISION)


STRONG = "checkers", "one_cell", "half", "any"


@map_family(product((140.0, 300.0), STRONG), range_db=Real(0.0, 300.0, 140.0), strong=Choice(*STRONG))
def map_range(plugin: Detector, seed: int, range_db: float, strong: str) -> MapCase:
    """Noise whose cells are up to 300 dB stronger than their neighbours."""
    share = np.random.default_rng([seed, 1]).random(SHAPE) if strong == "any" else np.zeros(SHAPE)
    checkers = np.indices(SHAPE).sum(axis=0) % 2 == 1
    filled = {"checkers": checkers, "one_cell": MIDDLE, "half": np.s_[:, 9:]}
    if strong in filled:
        share[filled[strong]] = 1.0
    power = white_noise_map(SHAPE, seed) * 10.0 ** (range_db / 10 * (share - 0.5))
    return MapSubject(plugin, power), (*EVERY_MAP, *MAP_INVARIANT)


@map_family(
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
    nothing = (maps.NOTHING,) if filled in ("zeros", "constant") else ()
    return MapSubject(plugin, power), (*EVERY_MAP, *nothing, maps.MAP_TWO_POWER_SCALE)


@map_family(
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
    return MapSubject(detector, white_noise_map(shape, seed)), EVERY_MAP if is_whole else (maps.REFUSED,)


@map_family(
    [(-15.0, 1), (-15.0, 1024), (-2.0, 1), (-3.0, 256), (-0.31, 1), (-0.31, 16)],
    exponent=Real(-15.0, -0.31, -3.0),
    looks=Whole(1, 1024, 1),
)
def rate(plugin: Detector, seed: int, exponent: float, looks: int) -> MapCase:
    """Any probability of false alarm, and any number of looks."""
    power = white_noise_map((9, 11), seed, looks)
    power[0, 0] = ECHO  # in a corner that half of the windows do not reach
    subject = MapSubject(with_parameters(plugin, pfa=10.0**exponent), power, looks)
    return subject, (*EVERY_MAP, *MAP_INVARIANT, maps.FALSE_ALARM_RATE, maps.RATE_ORDER)
