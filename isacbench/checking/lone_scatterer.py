"""A lone scatterer: whether it is imaged where it is and as strong as it is, and else by which mistake.

Two views of a scatterer are imaged. A known mistake leads to a certain place in each of them, so it is named
where both images have most of their power there. An offset is the same in both views, and what does not
depend on the echo has the same place in both. Sidelobes, which lie elsewhere in each view, decide nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache, cached_property
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from isacbench.bench.cells.images import raw_cloud
from isacbench.checked_arrays import Floats, parts_of
from isacbench.checking.checks import CheckFailedError, DoubtfulError
from isacbench.checking.scenes import LONE_VIEWS, SmallScene, lone
from isacbench.model.cloud import PointCloud
from isacbench.model.frame import FrameName
from isacbench.model.observation import Observation
from isacbench.model.radio_coordinates import radio_places, rayleigh_cells
from isacbench.plugins.contracts import Estimator

MISS_CELLS = 2.0
"""Rayleigh cells beyond which a point is not of a place."""

BIAS_CELLS = 0.35
"""Mean error in both views, in Rayleigh cells, from which bins are not the nearest: near half a bin."""

OFF_CELLS = 0.6
"""Error in one view, in Rayleigh cells, from which a bin is not the nearest: half a bin, and noise."""

SHIFTED_CELLS = 0.8
"""Mean error in both views, in Rayleigh cells, that is more than half a bin and noise."""

TIE_CELLS = 0.1
"""Difference of errors, in Rayleigh cells, that rounding makes."""

MOST = 0.25
"""Power at a place, over that at the place with most of it, from which the image may be of that place."""

SPREAD = 0.125
"""Share of the power of an image at its strongest place, below which powers do not tell the place."""

POWER_FACTOR = 10.0

AT_ONCE = 1 << 14
"""About as many distances of points from places are in memory at once."""

SAME_LAW = 0.1
"""Largest difference of the exponent of a power law, and largest relative one of a difference in dB."""

NO_TURN = 1e9
"""Period of a coordinate that has none."""

AXES = "range", "velocity", "u", "w"


class Place(NamedTuple):
    """Place that mistakes lead to.

    Attributes
    ----------
    mistakes : tuple of (str, str)
        In words, each with its remedy; none for the true place.
    at : ndarray of float64, shape (4,)
        Range, velocity, u and w in Rayleigh cells.
    stretch : ndarray of float64, shape (4,)
        How much errors grow by the mistakes; at least 1.
    """

    mistakes: tuple[tuple[str, str], ...]
    at: Floats
    stretch: Floats


def places_of_mistakes(scene: SmallScene, true: Floats) -> Iterator[Place]:
    """List where mistakes put the scatterer of a scene, first its true place, all in Rayleigh cells."""
    cells, gate = rayleigh_cells(scene.scenario), scene.observation.gate
    first_range, last_range = map(float, gate.range_bins[[0, -1]])
    first_doppler = float(gate.doppler_bins[0])
    placed = "observation.cloud(...) takes bins"
    # In words, the remedy, and the factor and the offset that lead from the true coordinate to the wrong one.
    upwards = "observation.gate.range_bins counts upwards"
    bins = "a bin of observation.gate.range_bins is observation.system.range_bin_m, one way"
    ranges = [
        ("", "", 1.0, 0.0),
        ("range had the wrong sign", "bins count upwards from observation.gate.range_bins[0]", -1, 0),
        ("range was there and back", bins, 2, 0),
        ("range was halved once too often", bins, 0.5, 0),
        ("range was in m where bins are wanted", placed, cells[0], 0),
        ("range was in bins where m are wanted", bins, 1 / cells[0], 0),
        ("range was the index into the gate", "take observation.gate.range_bins[index]", 1, -first_range),
        ("range ran backwards through the gate", upwards, -1, first_range + last_range),
    ]
    bins = "a bin of observation.gate.doppler_bins is observation.system.velocity_bin_mps"
    index = "take observation.gate.doppler_bins[index]"
    velocities = [
        ("", "", 1.0, 0.0),
        ("velocity had the wrong sign", "v > 0 approaches", -1, 0),
        ("velocity was twice as large", bins, 2, 0),
        ("velocity was half as large", bins, 0.5, 0),
        ("velocity was in km/h", "give it in m/s", 3.6, 0),
        ("velocity was in m/s where bins are wanted", placed, cells[1], 0),
        ("velocity was in bins where m/s are wanted", bins, 1 / cells[1], 0),
        ("velocity was 0", "take it from the Doppler bin of the detection", 0, 0),
        ("velocity was the index into the gate", index, 1, -first_doppler),
    ]
    for along, moving, facing in product(ranges, velocities, [*_directions(true[2:] * cells[2:])]):
        *_, uw, stretch = facing
        at = np.r_[true[0] * along[2] + along[3], true[1] * moving[2] + moving[3], uw / cells[2:]]
        mistakes = tuple((words, remedy) for words, remedy, *_ in (along, moving, facing) if words)
        yield Place(mistakes, at, np.array([along[2], moving[2], stretch, stretch]).clip(1))


def _directions(uw: Floats) -> Iterator[tuple[str, str, Floats, float]]:
    """Mistakes of direction cosines, first none, with what they make of them and of small errors."""
    signs = {(1, 1): "", (-1, 1): "u had the wrong sign", (1, -1): "w had the wrong sign"}
    for is_swapped, u, w in product((False, True), (1, -1), (1, -1)):
        swapped, wrong = "u and w were swapped" * is_swapped, signs.get((u, w), "u and w had the wrong signs")
        words = " and ".join(filter(None, (swapped, wrong)))
        remedy = "the phase of element (p, q) is -π (p u + q w)"
        yield words, remedy, (uw[::-1] if is_swapped else uw) * [u, w], 1
    twice, sines = "a cosine is twice numpy.fft.fftfreq", "they are direction cosines, the sines of those"
    yield "u and w ran from 0 to 2", "subtract 2 above 1, as numpy.fft.fftfreq does", uw % 2, 1
    yield "u and w began at -1 without numpy.fft.fftshift", twice, uw % 2 - 1, 1
    yield "u and w ran from 0 to 1", twice, uw % 2 / 2, 1
    yield "u and w were halved", twice, uw / 2, 1
    yield "u and w were twice as large", twice, uw * 2, 2
    yield "u and w were phases", "divide those between elements by -π", uw * np.pi, np.pi
    yield "u and w were angles in radians", sines, np.arcsin(uw), 1
    yield "u and w were angles in degrees", sines, np.rad2deg(np.arcsin(uw)), 120


@cache
def _places(frame: FrameName) -> tuple[list[Place], Floats, Floats]:
    """Places of mistakes in a view, and where they are and their stretch as arrays (places, 4)."""
    scenario = lone(frame).scenario
    true = radio_places(scenario, scenario.truth)[0] / rayleigh_cells(scenario)
    places = [*places_of_mistakes(lone(frame), true)]
    return places, np.array([one.at for one in places]), np.array([one.stretch for one in places])


class _Image:
    """Points (n, 4) of an image of a lone scatterer: range, velocity, u and w in Rayleigh cells.

    The cloud is the image that the points are of, or that was made of them.
    """

    def __init__(self, frame: FrameName, points: Floats, cloud: PointCloud, power: Floats) -> None:
        self.frame, self.cloud, self.power = frame, cloud, power
        scenario = self.scenario = lone(frame).scenario
        self._turns = np.array([scenario.system.n_subcarriers, scenario.system.n_symbols, NO_TURN, NO_TURN])
        self._cells = rayleigh_cells(scenario)
        self.points = self._wrapped(points)
        self._weights = power.clip(0) if power.max(initial=0) > 0 else np.ones_like(power)
        self._sum = float(self._weights.sum())
        self.places, self.at, self._stretch = _places(frame)
        self.true = self.at[0]

    def __len__(self) -> int:
        return len(self.points)

    @cached_property
    def offset(self) -> Floats:
        """Offset (4,) of the image from the scatterer."""
        start = self.true if self.is_at[0] else self._fullest[0]
        return self._settled(start, np.ones(4)) - self.true

    @property
    def cosine(self) -> float:
        """Largest magnitude of u and w where the image has most power."""
        return float(np.abs(self._fullest[0] * self._cells)[2:].max())

    @cached_property
    def _fullest(self) -> tuple[Floats, float]:
        """Centre (4,) of the Rayleigh cell with most power, and that power."""
        centres, which = np.unique(np.rint(self.points), axis=0, return_inverse=True)
        sums = np.bincount(which.ravel(), self._weights)
        return centres[sums.argmax()], float(sums.max())

    @cached_property
    def _powers(self) -> Floats:
        """Power at each place."""
        parts = parts_of(len(self.at), AT_ONCE // max(len(self), 1))
        near = (self._near(self.at[some, None], self._stretch[some, None]) for some in parts)
        return np.concatenate([one @ self._weights for one in near])

    @cached_property
    def _most(self) -> float:
        return max(self._fullest[1], float(self._powers.max()))

    @cached_property
    def is_at(self) -> NDArray[np.bool_]:
        """Mask of the places that hold much of the power."""
        return self._powers >= MOST * min(self._sum, self._most)

    @property
    def is_spread(self) -> bool:
        """Tell whether some of the power is at the scatterer, but as much is all over the image."""
        is_there = self.cosine <= 1 and self._powers[0] > 0
        return is_there and self._most < SPREAD * self._sum

    def error(self, number: int) -> float:
        """Largest error on any axis if the image is at a place where much of its power is."""
        place = self.places[number]
        off = self._settled(place.at, place.stretch) - self._wrapped(place.at)
        allowed = OFF_CELLS + BIAS_CELLS * (place.stretch - 1)
        return float(np.abs(off).max()) if (np.abs(off) <= allowed).all() else np.inf

    @cached_property
    def sighted(self) -> NDArray[np.intp]:
        """Points within `MISS_CELLS` of the scatterer, the strongest first."""
        near = np.flatnonzero(self._near(self.true, np.full(4, MISS_CELLS)))
        return near[np.argsort(-self.power[near], kind="stable")]

    @property
    def miss_m(self) -> float:
        """Distance in m from the scatterer to the strongest point near it."""
        return float(np.linalg.norm(self.cloud.xyz[self.sighted[0]] - self.scenario.truth.xyz[0]))

    def _near(self, places: Floats, radius: Floats) -> Any:
        """Mask (..., n) of the points near places (..., 1, 4)."""
        return np.all(np.abs(self.points - self._wrapped(places)) <= radius, axis=-1)

    def _settled(self, place: Floats, radius: Floats) -> Floats:
        """Centre of power (4,) around a place, found from centre to centre."""
        for _ in range(4):
            near = self._near(place, radius)
            if not near.any():
                break
            place = np.average(self.points[near], axis=0, weights=self._weights[near] + 1e-30)
        return place

    def _wrapped(self, places: Floats) -> Floats:
        """Places (..., 4) with the first of their range and Doppler bins on either side of 0."""
        wrapped: Floats = places - self._turns * np.rint(places / self._turns)
        return wrapped


def require_lone_scatterer(estimator: Estimator) -> str:
    """Require that a lone scatterer is imaged where and as strong as it is; return its errors in words.

    There is a view in either frame; their scatterers differ in place and in power. Fails where the
    scatterer is imaged elsewhere or not at all, doubts half a bin and a wrong power.
    """
    placed, imaged = zip(*(_images(estimator, frame) for frame in LONE_VIEWS), strict=True)
    # What the region leaves of a wrong image may be a sidelobe at the right place: look before it does.
    first = [one if len(one) else other for one, other in zip(placed, imaged, strict=True)]
    if not all(map(len, first)):
        raise CheckFailedError(
            "images nothing where one scatterer stands far above the noise: it is not detected, or all "
            "detections fall outside the region (place them with observation.cloud(...), and this check says "
            "by which mistake)"
        )
    _require_place(estimator, first)
    bias = _bias(np.array([image.offset for image in first]))
    if not bias and all(map(len, imaged)):
        _require_place(estimator, imaged)
    is_sighted = all(len(image.sighted) for image in imaged)
    if not is_sighted and not bias:
        raise CheckFailedError(
            "drops a lone scatterer that it has placed rightly: look at what follows observation.cloud(...)"
        )
    doubts = [bias, _wrong_power(*imaged) if is_sighted else ""]
    if any(doubts):
        raise DoubtfulError("; and ".join(filter(None, doubts)))
    return ", ".join(f"{image.miss_m:.2g} m off in the {image.frame} frame" for image in imaged)


def _images(estimator: Estimator, frame: FrameName, *, mixed: bool = False) -> tuple[_Image, _Image]:
    """Image of all that was placed for an image, and the image itself; of cells in other places if mixed."""
    scene = lone(frame)
    if mixed:
        scene = scene.with_cells(scene.observation.cells[::-1, ::-1])
    observation = scene.fresh_observation()
    placed: list[Floats] = [np.empty((0, 5))]

    def cloud(range_bin: Any, doppler_bin: Any, u: Any, w: Any, power: Any) -> PointCloud:
        points = Observation.cloud(observation, range_bin, doppler_bin, u, w, power)
        columns = np.broadcast_arrays(range_bin, doppler_bin, u, w, power)
        placed.append(np.stack(columns, axis=-1).astype(np.float64).reshape(-1, 5))
        return points

    vars(observation)["cloud"] = cloud
    image = raw_cloud(estimator, observation, scene.scenario.truth)
    found = np.concatenate(placed)
    found = found[np.isfinite(found).all(axis=1)]
    cells = rayleigh_cells(scene.scenario)
    return (
        _Image(frame, found[:, :4] / [1, 1, *cells[2:]], image, found[:, 4]),
        _Image(frame, radio_places(scene.scenario, image) / cells, image, image.power),
    )


def _require_place(estimator: Estimator, images: Sequence[_Image]) -> None:
    """Refuse images that have the scatterer elsewhere, by the name of the mistake."""
    off = np.array([image.offset for image in images])
    wrong = [image for image in images if np.abs(image.offset).max() > BIAS_CELLS]
    if not wrong:
        return
    is_far = np.abs(off).max() > MISS_CELLS or np.abs(off.mean(axis=0)).max() > SHIFTED_CELLS
    if is_far and _ignores_the_cells(estimator, wrong[0]):
        raise CheckFailedError(
            "images the same points whatever the cells hold: estimate them from observation.cells"
        )
    if all(image.is_spread for image in images):
        raise DoubtfulError(
            "images a lone scatterer by points all over the scene, none of which stands out: give each its "
            "power, |cells|² / observation.system.processing_gain"
        )
    for some in (images, wrong) if len(wrong) < len(images) else (images,):
        where = f" ({wrong[0].frame} frame)" if some is wrong else ""
        # An offset that both images have is no other mistake.
        shift = np.array([image.offset for image in some])
        spread = np.abs(shift - shift.mean(axis=0)).max() if len(some) > 1 else np.inf
        error, mistakes = _likeliest(some)
        if error <= min(spread + TIE_CELLS, np.abs(shift).max() / 2):
            words, remedies = (" and ".join(dict.fromkeys(part)) for part in zip(*mistakes, strict=True))
            raise CheckFailedError(f"images a lone scatterer where it would be if {words}: {remedies}{where}")
    if is_far:
        raise CheckFailedError(_astray(images, off))


def _likeliest(images: Sequence[_Image]) -> tuple[float, tuple[tuple[str, str], ...]]:
    """Largest error, in Rayleigh cells, that the mistakes leave that explain all images best, and these."""
    is_wrong = np.any([np.abs(image.at - image.true).max(axis=1) > OFF_CELLS for image in images], axis=0)
    is_wrong &= np.all([image.is_at for image in images], axis=0)
    errors = [
        (max(image.error(number) for image in images), images[0].places[number].mistakes)
        for number in np.flatnonzero(is_wrong).tolist()
    ]
    return min(errors, key=lambda one: one[0], default=(np.inf, ()))


def _ignores_the_cells(estimator: Estimator, image: _Image) -> bool:
    """Tell whether an image stays what it is when the cells change places."""
    placed, imaged = _images(estimator, image.frame, mixed=True)
    if len(image.cloud):
        return np.array_equal(image.cloud.to_array(), imaged.cloud.to_array())
    return np.array_equal(image.points, placed.points)


def _astray(images: Sequence[_Image], off: Floats) -> str:
    """Say where images are whose mistake is not known, from the offsets (2, 4) of both views."""
    cosine = max(image.cosine for image in images)
    if cosine > np.pi / 2:  # which no offset makes of a cosine
        return f"directions of a lone scatterer reach {cosine:.3g}: u and w are cosines, between -1 and 1"
    places = off + [image.true for image in images]
    is_same = np.abs(places[0] - places[1]) <= BIAS_CELLS
    if is_same.any():
        same = " and ".join(axis for axis, one in zip(AXES, is_same, strict=True) if one)
        return f"images all lone scatterers at the same {same}: estimate that from observation.cells, too"
    offsets = [
        f"{' and '.join(dict.fromkeys(f'{one:+.2g}' for one in both))} in {axis}"
        for axis, both in zip(AXES, off.T, strict=True)
        if np.abs(both).max() > OFF_CELLS
    ]
    return (
        f"images of lone scatterers far above the noise are off by {', '.join(offsets)}, in Rayleigh cells: "
        "look at units (m, m/s), at signs, and at the first bins of observation.gate"
    )


def _bias(off_cells: Floats) -> str:
    """Say that bins are not the nearest ones, from the errors (2, 4) in both views; empty if they are."""
    axes = [
        f"{axis} ({both[0]:+.2f} and {both[1]:+.2f} Rayleigh cells)"
        for axis, both in zip(AXES, off_cells.T, strict=True)
        if abs(both.mean()) > BIAS_CELLS or np.abs(both).max() > OFF_CELLS
    ]
    largest = np.abs(off_cells).max()
    amount = "about half a bin" if largest <= SHIFTED_CELLS else f"up to {largest:.2g} cells"
    remedy = "take the nearest bin, not the one below or above, and bins as observation.gate has them"
    return f"images lone scatterers {amount} off in {' and '.join(axes)}: {remedy}" if axes else ""


def _wrong_power(one: _Image, two: _Image) -> str:
    """Say what is wrong with the powers of two scatterers that differ in power; empty if nothing is."""
    powers = np.array([image.power[image.sighted[0]] for image in (one, two)])
    true = np.array([image.scenario.truth.power[0] for image in (one, two)])
    factors = powers / true
    if np.all((factors > 1 / POWER_FACTOR) & (factors < POWER_FACTOR)):
        return ""
    with np.errstate(divide="ignore", invalid="ignore"):
        exponent = np.diff(np.log10(powers))[0] / np.diff(np.log10(true))[0]
    tens_of_db = np.diff(powers)[0] / (10 * np.diff(np.log10(true))[0])
    gain = one.scenario.system.processing_gain
    wanted = "a power is |G|² relative to a unit scatterer, |cells|² / observation.system.processing_gain"
    if abs(exponent - 0.5) < SAME_LAW:
        wanted = "these follow the amplitude, a power is its square"
    elif abs(exponent - 1) < SAME_LAW:
        if np.all(np.abs(np.log10(factors / gain)) < np.log10(POWER_FACTOR)):
            wanted = "divide by observation.system.processing_gain"
    elif min(abs(tens_of_db - 1), abs(tens_of_db - 2) / 2) < SAME_LAW:
        wanted = "these are in dB, give the power itself"
    return f"powers of {true[0]:g} and {true[1]:g} come out as {powers[0]:.3g} and {powers[1]:.3g}: {wanted}"
