"""A lone scatterer: whether it is imaged where it is and as strong as it is, and else by which mistake.

Where an image has the scatterer is where its power is: each point votes by its power for the nearest of the
places that the known mistakes lead to, the true one among them. So sidelobes, which lie on all sides, decide
nothing, whether they are weak or, in an image whose points are all as strong, merely fewer.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from isacbench.bench.cells.radio_coordinates import radio_places, rayleigh_cells
from isacbench.checking.contract.findings import DoubtfulError
from isacbench.checking.promises.image_promises import Imaging
from isacbench.checking.promises.promise import BrokenPromiseError
from isacbench.model.cloud import PointCloud
from isacbench.model.frame import FrameName
from isacbench.model.numerology import System
from isacbench.model.observation import Observation

Floats = NDArray[np.float64]

MISS_CELLS = 2.0
"""Rayleigh cells beyond which a point is not of a place."""

BIAS_CELLS = 0.35
"""Mean error in both views, in Rayleigh cells, from which bins are not the nearest: near half a bin."""

OFF_CELLS = 0.6
"""Error in one view, in Rayleigh cells, from which a bin is not the nearest: half a bin, and noise."""

RADIANS_CELLS = 0.25
"""Difference from the error of angles in radians, in Rayleigh cells, up to which they are the mistake."""

POWER_FACTOR = 10.0

SAME_LAW = 0.1
"""Largest difference of the exponent of a power law, and largest relative one of a difference in dB."""

Mistake = tuple[str, str]
"""Mistake in words, and its remedy."""

AXES = "range", "velocity", "u", "w"


class Sighting(NamedTuple):
    """Image of a lone scatterer that is where it should be.

    Attributes
    ----------
    miss_m : float
        Distance of its strongest point.
    off_cells : ndarray of float64, shape (4,)
        Error of its centre of power along `AXES`, in Rayleigh cells.
    power, true_power, gain : float
        Imaged and true power, and the processing gain.
    """

    miss_m: float
    off_cells: Floats
    power: float
    true_power: float
    gain: float


def require_lone_scatterer(views: Mapping[FrameName, Imaging]) -> str:
    """Require that a lone scatterer is imaged where and as strong as it is.

    Parameters
    ----------
    views : mapping of str to Imaging
        Two, by the name of the frame; their scatterers differ in power.

    Returns
    -------
    str
        Its errors in words.

    Raises
    ------
    BrokenPromiseError
        If it is imaged elsewhere, or not at all.
    DoubtfulError
        If it is imaged half a bin off, or its power is wrong.
    """
    seen = [_sighting(imaging, name) for name, imaging in views.items()]
    doubts = list(filter(None, (_bias(np.array([one.off_cells for one in seen])), _wrong_power(*seen))))
    if doubts:
        raise DoubtfulError("; and ".join(doubts))
    return ", ".join(
        f"{one.miss_m:.2g} m off in the {name} frame" for name, one in zip(views, seen, strict=True)
    )


def _sighting(imaging: Imaging, frame: FrameName) -> Sighting:
    """Find the scatterer in its image; refuse an image that has it elsewhere, by the name of the mistake."""
    scenario = imaging.shot.scenario
    cells, truth = rayleigh_cells(scenario), scenario.truth
    true = radio_places(scenario, truth)[0] / cells
    cloud, placed = _image(imaging)
    points = _wrapped(radio_places(scenario, cloud) / cells, scenario.system)
    # What the region leaves of a wrong image may be a sidelobe at the right place: look before it does.
    detections = _wrapped(placed[:, :4] / [1, 1, *cells[2:]], scenario.system)
    images = [image for image in ((detections, placed[:, 4]), (points, cloud.power)) if len(image[0])]
    for image in images:
        if mistake := _mistake(*image, true, imaging):
            raise BrokenPromiseError(f"{mistake} ({frame} frame)")
    near = np.abs(points - true).max(axis=1, initial=0.0) <= MISS_CELLS
    if not near.any():
        raise BrokenPromiseError(
            "drops a lone scatterer that it has placed rightly: look at what follows observation.cloud(...)"
            if images
            else "images nothing where one scatterer stands far above the noise: it is not detected, or all "
            "detections fall outside the region (place them with observation.cloud(...), and this check says "
            "by which mistake)"
        )
    power = cloud.power[near]
    strongest = int(power.argmax())
    return Sighting(
        float(np.linalg.norm(cloud.xyz[near][strongest] - truth.xyz[0])),
        _centre(*images[0], true),
        float(power[strongest]),
        float(truth.power[0]),
        scenario.system.processing_gain,
    )


def _image(imaging: Imaging) -> tuple[PointCloud, Floats]:
    """Image, and range bin, Doppler bin, u, w and power (n, 5) of all that was placed for it."""
    observation = imaging.shot.observation()
    placed: list[Floats] = [np.empty((0, 5))]

    def cloud(
        range_bin: ArrayLike, doppler_bin: ArrayLike, u: ArrayLike, w: ArrayLike, power: ArrayLike
    ) -> PointCloud:
        points = Observation.cloud(observation, range_bin, doppler_bin, u, w, power)
        columns = np.broadcast_arrays(range_bin, doppler_bin, u, w, power)
        placed.append(np.stack(columns, axis=-1).astype(np.float64).reshape(-1, 5))
        return points

    vars(observation)["cloud"] = cloud
    image, found = imaging.image(observation), np.concatenate(placed)
    return image, found[np.isfinite(found).all(axis=1)]


def _centre(points: Floats, power: Floats, true: Floats) -> Floats:
    """Offset (4,) of the centre of power of the points near the scatterer, in Rayleigh cells."""
    near = np.abs(points - true).max(axis=1) <= MISS_CELLS
    offset: Floats = np.average(points[near] - true, axis=0, weights=_weights(power[near]))
    return offset


def _weights(power: Floats) -> Floats:
    return power.clip(0) if power.max(initial=0) > 0 else np.ones_like(power)


def _wrapped(points: Floats, system: System) -> Floats:
    """Points (n, 4) in Rayleigh cells, the first of their range and Doppler bins on either side of 0."""
    turns = np.array([system.n_subcarriers, system.n_symbols])
    bins = points[:, :2] - turns * np.rint(points[:, :2] / turns)
    return np.column_stack([bins, points[:, 2:]])


def _mistake(points: Floats, power: Floats, true: Floats, imaging: Imaging) -> str:
    """Say by which mistake the power of an image is not where the scatterer is; empty if it is there.

    Points and scatterer are range, velocity, u and w in Rayleigh cells.
    """
    scenario = imaging.shot.scenario
    cells = rayleigh_cells(scenario)
    mistakes, places = zip(*_places_of_mistakes(true, cells), strict=True)
    candidates, weights = _wrapped(np.array(places), scenario.system), _weights(power)
    nearest = cKDTree(candidates).query(points)[1]
    voted = np.where(np.abs(points - candidates[nearest]).max(axis=1) <= MISS_CELLS, nearest, len(places))
    votes = np.bincount(voted, weights, len(places) + 1)[:-1]
    strongest = points[weights.argmax()]
    elsewhere = (voted == len(places)) & (np.abs(points - strongest).max(axis=1) <= MISS_CELLS)
    found = mistakes[votes.argmax()] if votes.max() >= weights[elsewhere].sum() else None
    if found == ():
        # An error of less than a cell, too small for votes.
        in_radians = np.arcsin(true[2:] * cells[2:]) / cells[2:] - true[2:]
        if np.abs(_centre(points, power, true)[2:] - in_radians).max() > RADIANS_CELLS:
            return ""
        found = (("u and w were angles in radians", "they are direction cosines, the sines of those"),)
    if _ignores_the_cells(imaging):
        return "images the same points whatever the cells hold: estimate them from observation.cells"
    if found:
        words, remedies = (" and ".join(dict.fromkeys(part)) for part in zip(*found, strict=True))
        return f"images a lone scatterer where it would be if {words}: {remedies}"
    cosine = float(np.abs(strongest * cells)[2:].max())
    if cosine > 1:
        unit = "degrees" if cosine > np.pi else "radians"
        return (
            f"directions of a lone scatterer reach {cosine:.3g}: u and w are cosines, between -1 and "
            f"1, not angles in {unit}"
        )
    off = np.abs(strongest - true)
    told = [f"{one:.3g} in {axis}" for axis, one in zip(AXES, off, strict=True) if one > MISS_CELLS]
    return (
        f"the image of a lone scatterer far above the noise is off by {' and '.join(told)}, in Rayleigh "
        "cells: look at units (m, m/s) and signs"
    )


def _places_of_mistakes(true: Floats, cells: Floats) -> Iterator[tuple[tuple[Mistake, ...], Floats]]:
    """Mistakes, and where they put a scatterer; first none, and the truth."""
    bins = "a bin of observation.gate.range_bins is observation.system.range_bin_m, one way"
    ranges = {
        1: ("", ""),
        -1: ("range had the wrong sign", "bins count upwards from observation.gate.range_bins[0]"),
        2: ("range was there and back", bins),
        0.5: ("range was halved once too often", bins),
        cells[0]: ("range was in m where bins are wanted", "observation.cloud(...) takes bins"),
        1 / cells[0]: ("range was in bins where m are wanted", bins),
    }
    bins = "a bin of observation.gate.doppler_bins is observation.system.velocity_bin_mps"
    velocities = {
        1: ("", ""),
        -1: ("velocity had the wrong sign", "v > 0 approaches"),
        2: ("velocity was twice as large", bins),
        0.5: ("velocity was half as large", bins),
        3.6: ("velocity was in km/h", "give it in m/s"),
        cells[1]: ("velocity was in m/s where bins are wanted", "observation.cloud(...) takes bins"),
        1 / cells[1]: ("velocity was in bins where m/s are wanted", bins),
        0: ("velocity was 0", "take it from the Doppler bin of the detection"),
    }
    directions = list(_directions(true[2:] * cells[2:]))
    for (r, along), (v, moving), (uw, facing) in product(ranges.items(), velocities.items(), directions):
        found = tuple(mistake for mistake in (along, moving, facing) if mistake[0])
        yield found, np.r_[true[0] * r, true[1] * v, uw / cells[2:]]


def _directions(uw: Floats) -> Iterator[tuple[Floats, Mistake]]:
    """Direction cosines that mistakes lead to, and the mistakes; first none."""
    for swapped, u, w in product((False, True), (1, -1), (1, -1)):
        signs = {(1, 1): "", (-1, 1): "u had the wrong sign", (1, -1): "w had the wrong sign"}
        wrong = signs.get((u, w), "u and w had the wrong signs")
        words = " and ".join(filter(None, ("u and w were swapped" if swapped else "", wrong)))
        yield (uw[::-1] if swapped else uw) * [u, w], (words, "the phase of element (p, q) is -π (p u + q w)")
    if uw.min() < 0:
        yield uw % 2, ("u and w ran from 0 to 2", "subtract 2 above 1, as numpy.fft.fftfreq does")


def _ignores_the_cells(imaging: Imaging) -> bool:
    """Tell whether an image stays what it is when the cells change places."""
    other = imaging.image_of(imaging.shot.seen.cells[::-1, ::-1].copy())
    return len(other) > 0 and np.array_equal(other.to_array(), imaging.cloud.to_array())


def _bias(off_cells: Floats) -> str:
    """Say that bins are not the nearest ones, from the errors (2, 4) in both views; empty if they are."""
    wrong = (np.abs(off_cells.mean(axis=0)) > BIAS_CELLS) | (np.abs(off_cells).max(axis=0) > OFF_CELLS)
    told = [
        f"{AXES[axis]} ({off_cells[0, axis]:+.2f} and {off_cells[1, axis]:+.2f} Rayleigh cells)"
        for axis in np.flatnonzero(wrong)
    ]
    remedy = "take the nearest bin, not the one below or above, and bins as observation.gate has them"
    return f"images lone scatterers about half a bin off in {' and '.join(told)}: {remedy}" if told else ""


def _wrong_power(one: Sighting, two: Sighting) -> str:
    """Say what is wrong with the powers of two scatterers that differ in power; empty if nothing is."""
    factors = np.array([one.power / one.true_power, two.power / two.true_power])
    if np.all((factors > 1 / POWER_FACTOR) & (factors < POWER_FACTOR)):
        return ""
    decades = np.log10(one.true_power / two.true_power)
    exponent = np.log10(one.power / two.power) / decades if one.power and two.power else np.nan
    tens_of_db = (one.power - two.power) / (10 * decades)
    wanted = "a power is |G|² relative to a unit scatterer, |cells|² / observation.system.processing_gain"
    if abs(exponent - 0.5) < SAME_LAW:
        wanted = "these follow the amplitude, a power is its square"
    elif abs(exponent - 1) < SAME_LAW:
        if np.all(np.abs(np.log10(factors / one.gain)) < np.log10(POWER_FACTOR)):
            wanted = "divide by observation.system.processing_gain"
    elif min(abs(tens_of_db - 1), abs(tens_of_db - 2) / 2) < SAME_LAW:
        wanted = "these are in dB, give the power itself"
    return (
        f"powers of {one.true_power:g} and {two.true_power:g} come out as {one.power:.3g} and "
        f"{two.power:.3g}: {wanted}"
    )
