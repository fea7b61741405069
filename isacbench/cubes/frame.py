"""A recorded frame: its observation, whose cells are computed when an estimator reads them, and its summary.

A frame whose samples are conjugated, or whose array counts the other way, has
its echoes in other places: outside the region, or mirrored in it. The summary
reads one row and one column of the array and places the strongest echoes by
their range and by the peak of either line's spectrum, as the frame is,
and as it would be in other conventions.
"""

import warnings
from dataclasses import replace
from functools import cached_property
from itertools import compress, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import maximum_filter
from scipy.special import gammainccinv, gammaincinv

from isacbench.checked_arrays import checked_array
from isacbench.choices import Division, Sensing
from isacbench.cubes.opening import open_cube, read_grid, reopen_cube
from isacbench.cubes.tiles import Cube, gate_cells, require_grid_of, require_shape
from isacbench.dsp.null_carriers import NullCarriers, interpolate_nulls, used_band
from isacbench.errors import InputError, InputWarning
from isacbench.files.escaping import plural
from isacbench.link.sensing.division import Signal, division_factors, sensed_elements
from isacbench.model.gate import Gate, build_gate
from isacbench.model.observation import Observation, cross_elements
from isacbench.model.scene import Scenario
from isacbench.plugins.registry import get_detector

Echoes = tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]

MOST_MISSED = 10 ** (-33 / 20)
"""Amplitude of false ranges over that of an echo: estimators look as far down."""

MOST_MISSED_BEYOND = 10 ** (-10 / 20)
"""The same for echoes from beyond the region, of which a frame may have none."""

LEAST_SYMBOL = 1e-6
"""Smallest symbol over the largest of a transmitted grid: less is 0 but for the rounding of a transform."""

WEAK = 10 ** (-30 / 20)
"""Amplitude of a subcarrier over the largest symbol below which little was transmitted there."""

CubeLike = Any
"""Array in memory, HDF5 dataset, zarr array, or the path of a file that holds one."""

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
"""Level of false ranges from which the summary names them: estimators look nearly as far down."""


class CubeObservation(Observation):
    """Range-Doppler cells of a recorded frame, transformed when they are first read, and held from then on.

    `cells` reads the whole frame, `cross` one column and one row of the
    array. Built by `observe_cube`.

    Attributes
    ----------
    nulls : NullCarriers or None
        Null carriers of the frame; its `system` is that of the band between
        the outermost that are used.
    """

    nulls: NullCarriers | None
    _source: CubeLike
    _factors: NDArray[np.complex128] | None
    _workers: int | None

    def __init__(
        self,
        source: CubeLike,
        scenario: Scenario,
        factors: NDArray[np.complex128] | None,
        workers: int | None,
        sensing: Sensing,
        carriers: NDArray[np.bool_] | None = None,
    ) -> None:
        system = scenario.system
        if carriers is not None:  # that of the subcarriers from the first that is used to the last
            band = used_band(carriers)
            carrier_hz = system.carrier_hz + band.start * system.subcarrier_spacing_hz
            system = replace(system, n_subcarriers=band.stop - band.start, carrier_hz=carrier_hz)
        gate = build_gate(system, scenario.base_station_m, scenario.region)
        limits = float(gate.range_bins[0]), float(gate.range_bins[-1])
        vars(self).update(  # whose attributes are frozen
            gate=gate,
            system=system,
            array=scenario.array,
            frame=scenario.frame,
            base_station_m=scenario.base_station_m,
            region=scenario.region,
            sensing=sensing,
            _source=source,
            _factors=factors,
            nulls=None if carriers is None else interpolate_nulls(carriers, limits),
            _workers=workers,
        )

    @cached_property
    def cells(self) -> NDArray[np.complex128]:
        """Cells (n_range, n_doppler, P, Q) of all virtual elements, read-only."""
        cells = self.transformed(self.array.positions, self.gate)
        return cells.reshape(*self.gate.shape, *self.array.shape)

    @cached_property
    def cross(self) -> NDArray[np.complexfloating[Any, Any]]:
        """Cells (n_range, n_doppler, P + Q - 1) of the elements (p, 0), then of (0, q) from q = 1."""
        if "cells" in vars(self):
            return super().cross
        return self.transformed(cross_elements(self.array.shape), self.gate)

    def transformed(self, elements: NDArray[np.int64], gate: Gate) -> NDArray[np.complex128]:
        """Transform elements to the cells of a gate.

        Parameters
        ----------
        elements : ndarray of int64, shape (e, 2)
            Places in the virtual array.

        Returns
        -------
        ndarray of complex128, shape (n_range, n_doppler, e)
            Read-only.
        """
        places = self.array.in_frame(elements)
        with reopen_cube(self._source) as cube:
            cells = gate_cells(cube, places, gate, self.system, self.nulls, self._factors, self._workers)
        cells.setflags(write=False)
        return cells


def observe_cube(
    array_or_path: CubeLike,
    scenario: Scenario,
    transmitted: ArrayLike | str | Path | None = None,
    workers: int | None = None,
    *,
    sensing: Sensing = "all",
    division: Division = "reciprocal",
    snr_db: float | None = None,
) -> Observation:
    """Observe a recorded frame; its cells are transformed when an estimator reads them.

    Parameters
    ----------
    array_or_path : array_like, HDF5 dataset, zarr array, str or Path
        The cube, shape (n_subcarriers, n_symbols, P, Q), complex64 or
        complex128: what each virtual element received, per resource element.
        Its elements ascend as the scenario's array says (``ascending``).
        Files are ``.npy``, ``.npz``, ``.mat`` (7.3 as well), ``.h5``,
        ``.hdf5`` and ``.zarr``.
    scenario : Scenario
        Its system, array, frame, base station and region; its scatterers do
        not matter.
    transmitted : array_like, str or Path, optional
        Transmitted grid, shape (n_subcarriers, n_symbols), or the file that
        holds it. The cube is divided by it. Subcarriers that are 0 (below 1e-6
        of the largest) in all symbols are null carriers: those at the edges are left out of the
        band, and what others would have held is interpolated. Without it the transmitted grid in
        the file of the cube is taken; a cube without one counts as divided.
    workers : int, optional
        Threads of the transform; by default all cores.
    sensing : {"all", "prs"}
        Resource elements that are sensed with. In the others the transmitted
        grid may hold anything.
    division : {"reciprocal", "matched", "wiener"}
        How the cube is divided by the transmitted grid.
    snr_db : float, optional
        SNR of the echo per resource element, which Wiener division takes.

    Returns
    -------
    Observation
        Whose `cells` and `cross` raise `InputError` where what they read is
        not finite.

    Raises
    ------
    InputError
        If the file cannot be read or is damaged, the cube has the wrong
        shape or is not complex, or a division lacks the transmitted grid or the
        SNR that it takes.

    Warns
    -----
    InputWarning
        If null carriers between others are too many to be interpolated, or the
        transmitted grid is next to 0 in others, or the file holds what may be data and is not used.

    Examples
    --------
    >>> from isacbench import get_estimator, load_scenario
    >>> scenario = load_scenario("single")
    >>> shape = scenario.system.n_subcarriers, scenario.system.n_symbols, *scenario.array.shape
    >>> observation = observe_cube(np.zeros(shape, dtype=np.complex64), scenario)
    >>> len(get_estimator("music2d", integration="element").estimate(observation))
    0
    """
    if workers is not None and workers < 1:
        raise InputError(f"workers {workers}: allowed is 1 or more")
    scenario.require_default("a recorded frame", "mimo")
    signal = Signal(sensing=sensing, division=division)
    with open_cube(array_or_path) as cube:
        require_shape(cube, scenario.system, scenario.array)
        grid = cube.transmitted if transmitted is None else transmitted
        if isinstance(grid, str | Path):
            grid = read_grid(grid)
        sensed = sensed_elements(scenario.system, sensing)
        symbols = None if grid is None else _checked_grid(grid, cube, sensed, sensing)
        if symbols is None and division != "reciprocal":
            raise InputError(f"{cube.name}: division = {division!r} needs the transmitted grid")
        if (division == "wiener") != (snr_db is not None):
            raise InputError(
                f"{cube.name}: division = 'wiener', and no other, takes the SNR of the echo, snr_db"
            )
        known = np.ones(sensed.shape) if symbols is None else symbols
        used, factors = (known != 0).any(axis=1), None
        remarks: list[str] = []
        if symbols is not None or not sensed.all():
            amplitude = np.abs(known).max(axis=1, where=sensed, initial=0)
            is_weak = (amplitude > 0) & (amplitude < WEAK * amplitude.max())
            if division == "reciprocal" and is_weak.any():
                remarks.append(
                    f"{plural(int(is_weak.sum()), 'subcarrier')} from {is_weak.argmax()} on have less than "
                    f"{20 * np.log10(WEAK):.0f} dB of the largest symbol in the transmitted grid: the "
                    "division raises their noise as much; write 0 for null carriers, or choose "
                    "division = 'wiener'"
                )
            factors = np.zeros(sensed.shape, dtype=np.complex128)
            factors[used] = division_factors(
                known[used], sensed[used], signal.division, np.inf if snr_db is None else snr_db
            )
        source = cube if cube.is_in_memory else array_or_path
    observation = CubeObservation(source, scenario, factors, workers, sensing, None if used.all() else used)
    nulls = observation.nulls
    if nulls is not None and (nulls.missed > MOST_MISSED or nulls.missed_beyond > MOST_MISSED_BEYOND):
        own_db, beyond_db = (20 * np.log10(missed) for missed in (nulls.missed, nulls.missed_beyond))
        remarks.append(
            f"{nulls.null.size} null carriers lie between others: false ranges are up to "
            f"{own_db:.0f} dB of an echo from the region, up to {beyond_db:.0f} dB of one from beyond it; "
            "a region of fewer range bins leaves less"
        )
    for remark in remarks:
        warnings.warn(f"{cube.name}: {remark}", InputWarning, stacklevel=2)
    return observation


def _checked_grid(
    given: ArrayLike, cube: Cube, sensed: NDArray[np.bool_], sensing: Sensing
) -> NDArray[np.complex128]:
    """Transmitted grid without faults, and with zeros in null carriers alone, as complex128."""
    grid = checked_array(f"{cube.name}: the transmitted grid", given, np.complex128)
    require_grid_of(cube, grid)
    amplitude = np.abs(grid)
    is_zero = amplitude <= LEAST_SYMBOL * np.max(amplitude, where=sensed & np.isfinite(grid), initial=0)
    is_null = is_zero.all(axis=1) & ~is_zero.all() & (sensing == "all")
    faulty = sensed & (~np.isfinite(grid) | (is_zero & ~is_null[:, None]))
    if faulty.any():
        n, m = np.unravel_index(int(faulty.argmax()), faulty.shape)
        raise InputError(
            f"{cube.name}: the transmitted grid is {grid[n, m]:g} at subcarrier {n}, symbol {m}; allowed are "
            "finite numbers, and 0 only in subcarriers that are 0 in all symbols, with sensing = 'all' "
            f"(what is below {LEAST_SYMBOL:g} of the largest counts as 0)"
        )
    return np.where(is_null[:, None], 0, grid)


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
        sentences = [f"{place}, {where}; {plural(self.n_cells, 'cell')}, {n_detected}; {echoes}"]
        if self.changes:
            changes = " and ".join(self.changes)
            sentences.append(
                f"with {changes}, {self.changed_share:.0%} would: look at the signs of the frame, "
                "or for strong echoes from outside the region"
            )
        elif self.n_echoes and self.share < LEAST_SHARE:
            sentences.append(
                "the rest fits no other convention: look at the scenario's radio, place and region"
            )
        if self.leaked_db > MOST_LEAKED_DB:
            sentences.append(
                "null carriers: echoes from beyond the region leave false ranges up to "
                f"{self.leaked_db:.0f} dB of the strongest cell in the gate"
            )
        return sentences


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
    positive = power[power > 0] if power.any() else power
    least = np.median(positive) * gammainccinv(looks, NOISE_ECHOES / power.size) / gammaincinv(looks, 0.5)
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
