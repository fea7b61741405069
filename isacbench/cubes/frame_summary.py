"""Summary of a recorded frame: strongest cell, detected cells, and the convention that fits the region best.

A frame whose samples are conjugated, or whose array counts the other way, has
its echoes in other places: outside the region, or mirrored in it. The summary
reads one row and one column of the array and places the strongest echoes by
their range and by the peak of either line's spectrum, as the frame is,
and as it would be in other conventions.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy.fft
from scipy.ndimage import maximum_filter

from isacbench.cubes.frame_observation import CubeObservation
from isacbench.errors import InputError
from isacbench.files.escaping import counted
from isacbench.model.gate import Gate
from isacbench.model.observation import Observation, cross_elements
from isacbench.plugins.registry import get_detector

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Complex = NDArray[np.complex128]
    Floats = NDArray[np.float64]
    Integers = NDArray[np.intp]
    Mask = NDArray[np.bool_]

MOST_VALUES = 2**23
"""Cells of all elements that are read: 128 MiB. Of larger frames fewer elements are read."""

MOST_ECHOES = 64
"""Strongest echoes that are placed."""

COSINE_SAMPLES = 128
"""Samples of the spectrum of a line of elements."""

LEAST_DEVIATIONS = 8.0
"""Standard deviations of noise averaged over the elements, by which an echo exceeds the median of the map."""

CLEARLY_MORE = 0.1
"""Difference of two shares of the power from which the convention of the higher one is named."""


LEAST_SHARE = 0.5
"""Share of the power below which the scenario is doubted."""


class Convention(NamedTuple):
    """Changes that turn a frame into one of the usual convention.

    Attributes
    ----------
    conjugated, exchanged, u_reversed, w_reversed : bool
        Samples are conjugated; the axes of the elements are exchanged; then
        elements are counted from the other end along u, or along w.
    """

    conjugated: bool = False
    exchanged: bool = False
    u_reversed: bool = False
    w_reversed: bool = False

    def __str__(self) -> str:
        mirrored = [axis for axis, is_so in (("u", self.u_reversed), ("w", self.w_reversed)) if is_so]
        changes = ["its samples were conjugated"] * self.conjugated
        changes += ["the axes of its elements were exchanged"] * self.exchanged
        changes += [f"its elements were reversed along {' and '.join(mirrored)}"] * bool(mirrored)
        return " and ".join(changes)


@dataclass(frozen=True)
class FrameSummary:
    """Strongest cell, detected cells and fitting convention of a recorded frame.

    Attributes
    ----------
    range_m, velocity_mps : float
        Of the strongest cell of the whole range-Doppler map.
    is_in_gate : bool
        Whether a scatterer of the region can have its peak there.
    n_detected, n_cells : int
        Cells that a CFAR detector finds among those that the region can reach.
    n_echoes : int
        Strongest echoes of the map, at most `MOST_ECHOES`.
    share : float
        Share of their power that comes from the region; 0 if there are none.
    better : Convention or None
        Convention in which clearly more of it would, with the fewest changes.
    better_share : float
        Share in that convention.
    """

    range_m: float
    velocity_mps: float
    is_in_gate: bool
    n_detected: int
    n_cells: int
    n_echoes: int
    share: float
    better: Convention | None = None
    better_share: float = 0.0

    def sentences(self) -> list[str]:
        """Describe the frame, and the convention that fits better."""
        place = f"strongest cell at {self.range_m:.4g} m and {self.velocity_mps:.3g} m/s"
        where = "in the gate" if self.is_in_gate else "outside the gate"
        power = f"{self.share:.0%} of the power of the strongest echoes comes from the region"
        echoes = power if self.n_echoes else "no echo stands out of the noise"
        told = [f"{place}, {where}; {self.n_detected} of {counted(self.n_cells, 'cell')} detected; {echoes}"]
        if self.better is not None:
            told.append(f"if {self.better}, {self.better_share:.0%} would: look at the signs of the frame")
        elif self.n_echoes and self.share < LEAST_SHARE:
            told.append("the rest fits no other convention: look at the scenario's radio, place and region")
        return told


def summarise_frame(observation: Observation) -> FrameSummary:
    """Summarise a recorded frame, of which one row and one column of elements are read.

    Parameters
    ----------
    observation : Observation
        From `isacbench.observe_cube`.

    Returns
    -------
    FrameSummary

    Raises
    ------
    InputError
        If the observation is of no recorded frame, or what is read is not finite.
    """
    if not isinstance(observation, CubeObservation):
        raise InputError("only the observation of a recorded frame, from observe_cube, can be summarised")
    system, gate = observation.system, observation.gate
    n_range, n_doppler = system.n_subcarriers, system.n_symbols
    column, row = _elements(observation.array.shape, MOST_VALUES // (n_range * n_doppler))
    # All bins, those of negative ranges and speeds at the end.
    bins = np.arange(n_range), np.arange(n_doppler)
    whole = Gate(*bins, slice(0, n_range), slice(0, n_doppler), (True, True))
    cells = observation.transformed(np.concatenate([column, row]), whole)
    power = np.mean(cells.real**2 + cells.imag**2, axis=2)
    in_gate = np.ix_(gate.range_bins % n_range, gate.doppler_bins % n_doppler)
    detected = get_detector("osca").detect(power[in_gate], looks=cells.shape[2]).mask & gate.reachable
    reachable = np.zeros(power.shape, dtype=np.bool_)
    reachable[in_gate] = gate.reachable
    echoes = _strongest_echoes(cells, power, len(column))
    share, better, better_share = _best_convention(observation, echoes, reachable)
    strongest = np.unravel_index(int(power.argmax()), power.shape)
    doppler_bin = scipy.fft.fftfreq(n_doppler, 1 / n_doppler)[strongest[1]]
    return FrameSummary(
        range_m=float(strongest[0] * system.range_bin_m),
        velocity_mps=float(doppler_bin * system.velocity_bin_mps),
        is_in_gate=bool(reachable[strongest]),
        n_detected=int(np.count_nonzero(detected)),
        n_cells=int(np.count_nonzero(gate.reachable)),
        n_echoes=echoes.power.size,
        share=share,
        better=better,
        better_share=better_share,
    )


def _elements(shape: tuple[int, int], n_most: int) -> tuple[Integers, Integers]:
    """Elements of a column, and those of a row, at most `n_most` of both but one of each."""
    n_p = shape[0]
    cross = cross_elements(shape)
    n_column = min(n_p, max(n_most // 2, 1))
    return cross[:n_column], np.concatenate([cross[:1], cross[n_p:]])[: max(n_most - n_column, 1)]


class _Echoes(NamedTuple):
    """Range and Doppler bins, direction cosines and powers of n echoes."""

    range_bin: Integers
    doppler_bin: Integers
    u: Floats
    w: Floats
    power: Floats

    def after(self, convention: Convention, shape: tuple[int, ...]) -> _Echoes:
        """Echoes of a frame in another convention; conjugated samples have all signs reversed."""
        range_bin, doppler_bin, u, w, power = self
        if convention.conjugated:
            range_bin, doppler_bin, u, w = -range_bin % shape[0], -doppler_bin % shape[1], -u, -w
        if convention.exchanged:
            u, w = w, u
        u, w = (-u if convention.u_reversed else u), (-w if convention.w_reversed else w)
        return _Echoes(range_bin, doppler_bin, u, w, power)


def _strongest_echoes(cells: Complex, power: Floats, n_column: int) -> _Echoes:
    """Local maxima of a whole map, strongest first, each with the direction of its peak."""
    noise = np.median(power) * (1 + LEAST_DEVIATIONS / np.sqrt(cells.shape[2]))
    rows, columns = np.nonzero((power >= maximum_filter(power, size=3, mode="wrap")) & (power > noise))
    order = np.argsort(-power[rows, columns], kind="stable")[:MOST_ECHOES]
    rows, columns = rows[order], columns[order]
    snapshots = cells[rows, columns]
    u, w = _peak(snapshots[:, :n_column]), _peak(snapshots[:, n_column:])
    return _Echoes(rows, columns, u, w, power[rows, columns])


def _best_convention(
    observation: Observation, echoes: _Echoes, reachable: Mask
) -> tuple[float, Convention | None, float]:
    """Share of power from the region as the frame is; the convention with clearly more, and its share."""
    n_p, n_q = observation.array.shape
    conventions = [Convention(*changes) for changes in product((False, True), repeat=4)]
    share = {
        one: _share(observation, echoes.after(one, reachable.shape), reachable)
        for one in conventions
        if n_p == n_q or not one.exchanged
    }
    as_it_is, most = share[Convention()], max(share.values())
    if most < as_it_is + CLEARLY_MORE:
        return as_it_is, None, 0.0
    good = [one for one, its_share in share.items() if its_share > most - CLEARLY_MORE / 2]
    better = min(good, key=lambda one: (sum(one), -share[one]))
    return as_it_is, better, share[better]


def _share(observation: Observation, echoes: _Echoes, reachable: Mask) -> float:
    """Share of the power of echoes from cells and directions of the region, with half a beam around it."""
    xyz = observation.positions_m(echoes.range_bin, echoes.u, echoes.w)
    half_beam_m = np.linalg.norm(xyz - observation.base_station_m, axis=1) / min(observation.array.shape)
    inside = observation.region.contains(xyz, half_beam_m[:, None])
    inside &= reachable[echoes.range_bin, echoes.doppler_bin]
    return float(echoes.power @ inside / echoes.power.sum()) if echoes.power.any() else 0.0


def _peak(lines: Complex) -> NDArray[np.float64]:
    """Cosines (n,) at which the spectra of lines (n, elements) peak."""
    spectra = np.abs(scipy.fft.ifft(lines, COSINE_SAMPLES, axis=1))
    cosine: NDArray[np.float64] = 2 * scipy.fft.fftfreq(COSINE_SAMPLES)[spectra.argmax(axis=1)]
    return cosine
