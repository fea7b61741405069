"""Known mistakes of estimators, and where they put a scatterer."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from isacbench.checking.scenes import SmallScene
from isacbench.model.radio_coordinates import rayleigh_cells

Floats = NDArray[np.float64]

Mistake = tuple[str, str]
"""Mistake in words, and its remedy."""


class Place(NamedTuple):
    """Place that mistakes lead to.

    Attributes
    ----------
    mistakes : tuple of Mistake
        None for the true place.
    at : ndarray of float64, shape (4,)
        Range, velocity, u and w in Rayleigh cells.
    stretch : ndarray of float64, shape (4,)
        How much errors grow by the mistakes; at least 1.
    """

    mistakes: tuple[Mistake, ...]
    at: Floats
    stretch: Floats


def places_of_mistakes(scene: SmallScene, true: Floats) -> Iterator[Place]:
    """List where mistakes put the scatterer of a scene, first its true place, all in Rayleigh cells."""
    cells, gate = rayleigh_cells(scene.scenario), scene.seen.gate
    bins = "a bin of observation.gate.range_bins is observation.system.range_bin_m, one way"
    ranges: list[tuple[Mistake, float, float]] = [
        (("", ""), 1, 0),
        (("range had the wrong sign", "bins count upwards from observation.gate.range_bins[0]"), -1, 0),
        (("range was there and back", bins), 2, 0),
        (("range was halved once too often", bins), 0.5, 0),
        (("range was in m where bins are wanted", "observation.cloud(...) takes bins"), cells[0], 0),
        (("range was in bins where m are wanted", bins), 1 / cells[0], 0),
        (
            ("range was the index into the gate", "take observation.gate.range_bins[index]"),
            1,
            -float(gate.range_bins[0]),
        ),
        (
            ("range ran backwards through the gate", "observation.gate.range_bins counts upwards"),
            -1,
            float(gate.range_bins[0] + gate.range_bins[-1]),
        ),
    ]
    bins = "a bin of observation.gate.doppler_bins is observation.system.velocity_bin_mps"
    velocities: list[tuple[Mistake, float, float]] = [
        (("", ""), 1, 0),
        (("velocity had the wrong sign", "v > 0 approaches"), -1, 0),
        (("velocity was twice as large", bins), 2, 0),
        (("velocity was half as large", bins), 0.5, 0),
        (("velocity was in km/h", "give it in m/s"), 3.6, 0),
        (("velocity was in m/s where bins are wanted", "observation.cloud(...) takes bins"), cells[1], 0),
        (("velocity was in bins where m/s are wanted", bins), 1 / cells[1], 0),
        (("velocity was 0", "take it from the Doppler bin of the detection"), 0, 0),
        (
            ("velocity was the index into the gate", "take observation.gate.doppler_bins[index]"),
            1,
            -float(gate.doppler_bins[0]),
        ),
    ]
    for (along, r, r0), (moving, v, v0), (facing, uw, stretch) in product(
        ranges, velocities, [*_directions(true[2:] * cells[2:])]
    ):
        at = np.r_[true[0] * r + r0, true[1] * v + v0, uw / cells[2:]]
        mistakes = tuple(mistake for mistake in (along, moving, facing) if mistake[0])
        yield Place(mistakes, at, np.array([r, v, stretch, stretch]).clip(1))


def _directions(uw: Floats) -> Iterator[tuple[Mistake, Floats, float]]:
    """Mistakes of direction cosines, first none, with what they make of them and of small errors."""
    for swapped, u, w in product((False, True), (1, -1), (1, -1)):
        signs = {(1, 1): "", (-1, 1): "u had the wrong sign", (1, -1): "w had the wrong sign"}
        wrong = signs.get((u, w), "u and w had the wrong signs")
        words = " and ".join(filter(None, ("u and w were swapped" if swapped else "", wrong)))
        remedy = "the phase of element (p, q) is -π (p u + q w)"
        yield (words, remedy), (uw[::-1] if swapped else uw) * [u, w], 1
    twice, sines = "a cosine is twice numpy.fft.fftfreq", "they are direction cosines, the sines of those"
    yield ("u and w ran from 0 to 2", "subtract 2 above 1, as numpy.fft.fftfreq does"), uw % 2, 1
    yield ("u and w began at -1 without numpy.fft.fftshift", twice), uw % 2 - 1, 1
    yield ("u and w ran from 0 to 1", twice), uw % 2 / 2, 1
    yield ("u and w were halved", twice), uw / 2, 1
    yield ("u and w were twice as large", twice), uw * 2, 2
    yield ("u and w were phases", "divide those between elements by -π"), uw * np.pi, np.pi
    yield ("u and w were angles in radians", sines), np.arcsin(uw), 1
    yield ("u and w were angles in degrees", sines), np.rad2deg(np.arcsin(uw)), 120
