"""Summary of a recorded frame: strongest cell, detected cells, and the convention that fits the region best.

A frame whose samples are conjugated, or whose array counts the other way, has
its echoes in other places: outside the region, or mirrored in it. The summary
reads one row and one column of the array and places the strongest echoes by
their range and by the peak of either line's spectrum, as the frame is,
and as it would be in other conventions.
"""

from __future__ import annotations

from itertools import compress, product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy.fft
from scipy.ndimage import maximum_filter
from scipy.special import gammainccinv, gammaincinv

from isacbench.cubes.frame_observation import CubeObservation
from isacbench.errors import InputError
from isacbench.files.escaping import counted
from isacbench.model.gate import Gate
from isacbench.model.observation import Observation, cross_elements
from isacbench.plugins.registry import get_detector

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Echoes = tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]

MOST_VALUES = 2**23
"""Cells of all elements that are read: 128 MiB. Of larger frames fewer elements are read."""

MOST_ECHOES = 64
"""Strongest echoes that are placed."""

COSINE_SAMPLES = 128
"""Samples of the spectrum of a line of elements."""

NOISE_ECHOES = 1e-3
"""Mean number of echoes that are taken in a map of noise alone."""

CHANGES = (
    "conjugated samples",
    "subcarriers in descending order",
    "symbols in reverse order",
    "exchanged axes of the elements",
    "elements reversed along u",
    "elements reversed along w",
)
"""Changes of a frame, in their order, that are tried in all combinations."""

CLEARLY_MORE = 0.1
"""Difference of two shares of the power from which the changes with the higher one are named."""

LEAST_SHARE = 0.5
"""Share of the power below which the scenario is doubted."""

MOST_LEAKED_DB = -25.0
"""Level of false ranges that is told: estimators look nearly as far down."""


class FrameSummary(NamedTuple):
    """Strongest cell, detected cells and fitting convention of a recorded frame.

    Attributes
    ----------
    range_m, velocity_mps : float
        Of the strongest cell of the whole range-Doppler map; of the gate if only
        the PRS is sensed, for then echoes repeat outside.
    is_in_gate : bool
        Whether a scatterer of the region can have its peak there.
    n_detected : int or None
        Cells that a CFAR detector finds among those that the region can reach;
        None of a map smaller than the detector's window.
    n_cells : int
        Cells that the region can reach.
    n_echoes : int
        Strongest echoes of the map, at most `MOST_ECHOES`.
    share : float
        Share of their power that comes from the region; 0 if there are none.
    changes : tuple of str
        The fewest of `CHANGES` after which clearly more of it would; those of
        the order of subcarriers or symbols only if no others do.
    changed_share : float
        Share after them.
    leaked_db : float
        Most that echoes from ranges beyond the gate leave in false ranges,
        because carriers are null, over the strongest cell of the gate.
    """

    range_m: float
    velocity_mps: float
    is_in_gate: bool
    n_detected: int | None
    n_cells: int
    n_echoes: int
    share: float
    changes: tuple[str, ...]
    changed_share: float
    leaked_db: float

    def sentences(self) -> list[str]:
        """Describe the frame, and the convention that fits better."""
        place = f"strongest cell at {self.range_m:.4g} m and {self.velocity_mps:.3g} m/s"
        where = "in the gate" if self.is_in_gate else "outside the gate"
        power = f"{self.share:.0%} of the power of the strongest echoes comes from the region"
        echoes = power if self.n_echoes else "no echo stands out of the noise"
        n_detected = "too few for a detector" if self.n_detected is None else f"{self.n_detected} detected"
        told = [f"{place}, {where}; {counted(self.n_cells, 'cell')}, {n_detected}; {echoes}"]
        if self.changes:
            changes = " and ".join(self.changes)
            told.append(
                f"with {changes}, {self.changed_share:.0%} would: look at the signs of the frame, "
                "or for strong echoes from outside the region"
            )
        elif self.n_echoes and self.share < LEAST_SHARE:
            told.append("the rest fits no other convention: look at the scenario's radio, place and region")
        if self.leaked_db > MOST_LEAKED_DB:
            told.append(
                "null carriers: echoes from beyond the region leave false ranges up to "
                f"{self.leaked_db:.0f} dB of the strongest cell in the gate"
            )
        return told


def summarise_frame(observation: Observation) -> FrameSummary:
    """Summarise a recorded frame, of which one row and one column of elements are read.

    Parameters
    ----------
    observation : Observation
        From `isacbench.observe_cube`.

    Raises
    ------
    InputError
        If the observation is of no recorded frame, or what is read is not finite.
    """
    if not isinstance(observation, CubeObservation):
        raise InputError("only the observation of a recorded frame, from observe_cube, can be summarised")
    system, gate = observation.system, observation.gate
    shape, n_p = (system.n_subcarriers, system.n_symbols), observation.array.shape[0]
    n_most = max(MOST_VALUES // (shape[0] * shape[1] * 2), 1)
    cross = cross_elements(observation.array.shape)
    column, row = cross[:n_p][:n_most], cross[n_p:][: n_most - 1]
    # All bins, those of negative ranges and speeds at the end.
    whole = Gate(
        np.arange(shape[0]), np.arange(shape[1]), slice(0, shape[0]), slice(0, shape[1]), (True, True)
    )
    cells = observation.transformed(np.concatenate([column, row]), whole)
    cells = cells / max(np.abs(cells.real).max(), np.abs(cells.imag).max(), np.finfo(float).tiny)
    power = np.mean(cells.real**2 + cells.imag**2, axis=2)
    in_gate = np.ix_(gate.range_bins % shape[0], gate.doppler_bins % shape[1])
    try:
        detection = get_detector("osca").detect(power[in_gate], looks=cells.shape[2])
        n_detected = int(np.count_nonzero(detection.mask & gate.reachable))
    except InputError:  # the map is smaller than the window; not all estimators need a detector
        n_detected = None
    reachable = np.zeros(shape, dtype=np.bool_)
    reachable[in_gate] = gate.reachable
    if observation.sensing != "all":  # echoes repeat outside the gate
        power = np.where(reachable, power, 0)
    rows, columns = _strongest_echoes(power, cells.shape[2])
    echoes = cells[rows, columns]
    u, w = _peaks(echoes[:, : len(column)]), _peaks(np.delete(echoes, np.s_[1 : len(column)], axis=1))
    share, changes, changed_share = _best_changes(
        observation, reachable, (rows, columns, u, w), power[rows, columns]
    )
    strongest = np.unravel_index(int(power.argmax()), shape)
    return FrameSummary(
        range_m=float(strongest[0] * system.range_bin_m),
        velocity_mps=float(scipy.fft.fftfreq(shape[1], 1 / shape[1])[strongest[1]] * system.velocity_bin_mps),
        is_in_gate=bool(reachable[strongest]),
        n_detected=n_detected,
        n_cells=int(np.count_nonzero(gate.reachable)),
        n_echoes=len(rows),
        share=share,
        changes=changes,
        changed_share=changed_share,
        leaked_db=_leaked_db(observation, power.max(axis=1)),
    )


def _leaked_db(observation: CubeObservation, power: NDArray[np.float64]) -> float:
    """Level of false ranges, because of null carriers, of echoes beyond the gate over the strongest in it."""
    if observation.nulls is None:
        return -np.inf
    in_gate = observation.gate.range_bins % len(power)
    beyond = np.delete(np.arange(len(power)), in_gate)
    strongest = beyond[np.argsort(-power[beyond])[:MOST_ECHOES]]
    left = power[strongest] * observation.nulls.missed_at(strongest) ** 2
    least = power.max() * np.finfo(float).eps
    return float(10 * np.log10(max(left.max(initial=0), least) / max(power[in_gate].max(), least)))


def _strongest_echoes(power: NDArray[np.float64], looks: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of the local maxima of a whole map, strongest first."""
    # Noise averaged over looks is gamma-distributed.
    held = power[power > 0] if power.any() else power
    least = np.median(held) * gammainccinv(looks, NOISE_ECHOES / power.size) / gammaincinv(looks, 0.5)
    rows, columns = np.nonzero((power >= maximum_filter(power, size=3, mode="wrap")) & (power > least))
    order = np.argsort(-power[rows, columns], kind="stable")[:MOST_ECHOES]
    return rows[order], columns[order]


def _peaks(lines: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Cosines (n,) at which the spectra of lines (n, elements) peak."""
    spectra = np.abs(scipy.fft.ifft(lines, COSINE_SAMPLES, axis=1))
    cosine: NDArray[np.float64] = 2 * scipy.fft.fftfreq(COSINE_SAMPLES)[spectra.argmax(axis=1)]
    return cosine


def _best_changes(
    observation: Observation, reachable: NDArray[np.bool_], echoes: Echoes, power: NDArray[np.float64]
) -> tuple[float, tuple[str, ...], float]:
    """Share of power from the region; the fewest changes with clearly more, and their share."""
    weights = power / power.sum()
    shares = {
        changes: float(weights @ _come_from_region(observation, reachable, echoes, changes))
        for changes in product((False, True), repeat=len(CHANGES))
        if len(set(observation.array.shape)) == 1
        or not changes[CHANGES.index("exchanged axes of the elements")]
    }
    share, most = shares[(False,) * len(CHANGES)], max(shares.values())
    near_most = [changes for changes in shares if shares[changes] > most - CLEARLY_MORE / 2]
    orders = np.s_[1:3]  # a descending frequency or a reversed time is a rarer mistake
    fewest = min(near_most, key=lambda changes: (sum(changes[orders]), sum(changes), -shares[changes]))
    return share, tuple(compress(CHANGES, fewest)) if most >= share + CLEARLY_MORE else (), shares[fewest]


def _come_from_region(
    observation: Observation, reachable: NDArray[np.bool_], echoes: Echoes, changes: tuple[bool, ...]
) -> NDArray[np.bool_]:
    """Tell which echoes of a changed frame come from the region, or half a beam and a range bin around."""
    range_bin, doppler_bin, u, w = echoes
    conjugated, descending, backwards, exchanged, *mirrored = changes
    if exchanged:
        u, w = w, u
    signs = [-1 if conjugated != other else 1 for other in (descending, backwards, *mirrored)]
    cell = signs[0] * range_bin % reachable.shape[0], signs[1] * doppler_bin % reachable.shape[1]
    xyz = observation.positions_m(cell[0], signs[2] * u, signs[3] * w)
    half_beam_m = np.linalg.norm(xyz - observation.base_station_m, axis=1) / min(observation.array.shape)
    around_m = half_beam_m[:, None] + observation.system.range_bin_m / 2
    inside: NDArray[np.bool_] = observation.region.contains(xyz, around_m) & reachable[cell]
    return inside
