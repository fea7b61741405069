"""The observation of a recorded frame: range-Doppler cells that are computed when an estimator reads them."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isacbench.checked_arrays import Complex, checked_array
from isacbench.cubes.cube import Cube, require_shape
from isacbench.cubes.opening import open_cube, read_grid, reopen_cube
from isacbench.cubes.transform import GateTransform
from isacbench.dsp.null_carriers import NullCarriers, interpolate_nulls, used_band
from isacbench.errors import InputError, InputWarning
from isacbench.files.escaping import counted
from isacbench.link.sensing.division import Signal, division_factors, sensed_elements
from isacbench.model.gate import build_gate
from isacbench.model.observation import Observation, cross_elements

if TYPE_CHECKING:
    from isacbench.choices import Division, Sensing
    from isacbench.model.gate import Gate
    from isacbench.model.numerology import System
    from isacbench.model.scene import Scenario

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


class CubeObservation(Observation):
    """Range-Doppler cells of a recorded frame, transformed when they are first read, and then kept.

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
    _factors: Complex | None
    _workers: int | None

    def __init__(
        self,
        source: CubeLike,
        scenario: Scenario,
        factors: Complex | None,
        workers: int | None,
        sensing: Sensing,
        carriers: NDArray[np.bool_] | None = None,
    ) -> None:
        system = scenario.system if carriers is None else _used_band(scenario.system, carriers)
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
    def cells(self) -> Complex:
        """Cells (n_range, n_doppler, P, Q) of all virtual elements, read-only."""
        cells = self.transformed(self.array.positions, self.gate)
        return cells.reshape(*self.gate.shape, *self.array.shape)

    @cached_property
    def cross(self) -> NDArray[np.complexfloating[Any, Any]]:
        """Cells (n_range, n_doppler, P + Q - 1) of the elements (p, 0), then of (0, q) from q = 1."""
        if "cells" in vars(self):
            return super().cross
        return self.transformed(cross_elements(self.array.shape), self.gate)

    def transformed(self, elements: NDArray[np.int64], gate: Gate) -> Complex:
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
        transform = GateTransform(gate, self.system, self.nulls)
        with reopen_cube(self._source) as cube:
            cells = transform.cells(cube, self.array.in_frame(elements), self._factors, self._workers)
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
        symbols = None if grid is None else _checked(grid, cube, sensed, sensing)
        _require_known(cube, symbols, division, snr_db)
        factors = carriers = None
        if symbols is not None or not sensed.all():
            known = np.ones(sensed.shape) if symbols is None else symbols
            used = (known != 0).any(axis=1)
            if division == "reciprocal":
                _warn_of_weak_carriers(cube.name, np.abs(known).max(axis=1, where=sensed, initial=0))
            factors = np.zeros(sensed.shape, dtype=np.complex128)
            factors[used] = division_factors(
                known[used], sensed[used], signal.division, np.inf if snr_db is None else snr_db
            )
            carriers = None if used.all() else used
        source = cube if cube.is_held else array_or_path
    observation = CubeObservation(source, scenario, factors, workers, sensing, carriers)
    nulls = observation.nulls
    if nulls is not None and (nulls.missed > MOST_MISSED or nulls.missed_beyond > MOST_MISSED_BEYOND):
        own_db, beyond_db = (20 * np.log10(missed) for missed in (nulls.missed, nulls.missed_beyond))
        warnings.warn(
            f"{cube.name}: {nulls.null.size} null carriers lie between others: false ranges are up to "
            f"{own_db:.0f} dB of an echo from the region, up to {beyond_db:.0f} dB of one from beyond it; "
            "a region of fewer range bins leaves less",
            InputWarning,
            stacklevel=2,
        )
    return observation


def _used_band(system: System, carriers: NDArray[np.bool_]) -> System:
    """System of the subcarriers from the first that is used to the last."""
    band = used_band(carriers)
    carrier_hz = system.carrier_hz + band.start * system.subcarrier_spacing_hz
    return replace(system, n_subcarriers=band.stop - band.start, carrier_hz=carrier_hz)


def _warn_of_weak_carriers(name: str, amplitude: NDArray[np.float64]) -> None:
    """Tell of subcarriers in which little was transmitted: their noise is divided by next to nothing."""
    is_weak = (amplitude > 0) & (amplitude < WEAK * amplitude.max())
    if is_weak.any():
        warnings.warn(
            f"{name}: {counted(int(is_weak.sum()), 'subcarrier')} from {is_weak.argmax()} on have less than "
            f"{20 * np.log10(WEAK):.0f} dB of the largest symbol in the transmitted grid: the division "
            "raises their noise as much; write 0 for null carriers, or choose division = 'wiener'",
            InputWarning,
            stacklevel=3,
        )


def _require_known(cube: Cube, symbols: Complex | None, division: Division, snr_db: float | None) -> None:
    """Refuse divisions that lack the transmitted grid or the SNR, and an SNR that is not used."""
    if symbols is None and division != "reciprocal":
        raise InputError(
            f"{cube.name}: division = {division!r} needs the transmitted grid; "
            "a cube that is already divided takes only 'reciprocal'"
        )
    if division == "wiener" and (snr_db is None or np.isnan(snr_db)):
        raise InputError(f"{cube.name}: division = 'wiener' takes the SNR of the echo, snr_db = {snr_db}")
    if division != "wiener" and snr_db is not None:
        raise InputError(f"{cube.name}: snr_db needs division = 'wiener', not {division!r}")


def _checked(given: ArrayLike, cube: Cube, sensed: NDArray[np.bool_], sensing: Sensing) -> Complex:
    """Transmitted grid without faults, and with zeros in null carriers alone, as complex128."""
    grid = checked_array(f"{cube.name}: the transmitted grid", given, np.complex128)
    if grid.shape != cube.shape[:2]:
        raise InputError(
            f"{cube.name}: the transmitted grid has shape {grid.shape}; allowed is {cube.shape[:2]}, "
            "subcarriers by symbols as in the cube"
        )
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
