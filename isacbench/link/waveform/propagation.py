"""Propagation of the waveform: delayed and Doppler-shifted copies of it, many at once.

The waveform is continuous in time, and so are delays. A symbol that is late by
τ is its spectrum times exp(-j2π nΔf τ), behind an inverse DFT and within the
transmit window at the delayed instants: samples of it are exact, whatever the
delay. Doppler turns them along the time axis of the whole frame.

Received samples are made one symbol period after another. In each period a path
shows the symbol sent in it and, as far as it is late, those sent before. Where
and how is the same in all periods, up to a turn by Doppler, so that tables are
made for many periods at a time. Most of the work is saved where the receiver's
window sees one undisturbed symbol of a path: paths that stand still are then a
response of the spectrum, and paths of one speed are summed before their inverse
DFT.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.fft
from threadpoolctl import threadpool_limits

from isacbench.cores import available_cores
from isacbench.errors import InputError, require
from isacbench.link.waveform.ofdm import checked_grid, layout, n_samples, transmit_window
from isacbench.model.frozen_arrays import freeze_arrays
from isacbench.model.number_limits import require_all

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import ArrayLike, NDArray

    from isacbench.link.waveform.ofdm import SymbolLayout
    from isacbench.model.numerology import System

    Complex = NDArray[np.complex128]
    Floats = NDArray[np.float64]
    Index = NDArray[np.intp]

SAMPLES_TOGETHER = 2**23
"""Received samples of all elements made at a time: 128 MB."""

TABLE_VALUES = 2**19
"""Values of a table of paths and samples made at a time: 8 MB."""

FEW_VALUES = 2**17
"""Values to work on up to which starting threads takes longer than the work."""

WHOLE = 4 * np.finfo(np.float64).eps
"""Relative distance up to which a delay is a whole number of samples: rounding of seconds."""


@dataclass(frozen=True, eq=False)
class Paths:
    """Ways from the transmitter to every receiving element.

    Attributes
    ----------
    gain : ndarray of complex128, shape (K, E)
        Complex amplitude of each path at each element.
    delay_s : ndarray of float64, shape (K,)
        Not negative.
    doppler_hz : ndarray of float64, shape (K,)
        Doppler frequency, positive when the path grows shorter.

    Raises
    ------
    InputError
        If the shapes disagree, a number is not finite, or a delay is negative.
    """

    gain: Complex
    delay_s: Floats
    doppler_hz: Floats

    def __post_init__(self) -> None:
        freeze_arrays(self, "delay_s", "doppler_hz")
        freeze_arrays(self, "gain", dtype=np.complex128)
        n = self.delay_s.size
        if self.gain.ndim != 2 or {self.delay_s.shape, self.doppler_hz.shape, self.gain.shape[:1]} != {(n,)}:
            raise InputError(
                f"paths: gain {self.gain.shape}, delay_s {self.delay_s.shape} and doppler_hz "
                f"{self.doppler_hz.shape}; allowed are the shapes (K, E), (K,) and (K,)"
            )
        for name in ("gain", "doppler_hz"):
            values = getattr(self, name)
            require_all(f"paths.{name}", np.abs(values), np.isfinite(values), "finite numbers")
        is_delay = np.isfinite(self.delay_s) & (self.delay_s >= 0)
        require_all("paths.delay_s", self.delay_s, is_delay, "finite numbers of 0 and more")


def delay_samples(delay_s: ArrayLike, system: System) -> Floats:
    """Convert delays to samples at the critical rate.

    Parameters
    ----------
    delay_s : array_like, any shape
    system : System

    Returns
    -------
    ndarray of float64, same shape
        Whole where only rounding keeps them from it, because windows without a
        suffix are abrupt.
    """
    delay = np.asarray(delay_s, dtype=np.float64) * system.bandwidth_hz
    whole = np.rint(delay)
    samples: Floats = np.where(np.abs(delay - whole) <= WHOLE * whole, whole, delay)
    return samples


def shown_lags(delay: ArrayLike, parts: SymbolLayout, n_before: int = 0) -> tuple[Floats, Floats]:
    """Find which symbols a receiver's window sees of late echoes.

    Parameters
    ----------
    delay : array_like, any shape
        In samples.
    parts : SymbolLayout
    n_before : int
        Samples before the useful part that the window begins; it ends with the
        useful part.

    Returns
    -------
    lowest, highest : ndarray of float64, same shape
        The latest symbol and the earliest one of which something may be seen,
        as numbers of symbols that were sent since.

    Examples
    --------
    >>> from isacbench.link.waveform.ofdm import SymbolLayout
    >>> lowest, highest = shown_lags([0, 448, 449, 3000], SymbolLayout(2048, 512, 64))
    >>> lowest.tolist(), highest.tolist()
    ([0.0, 0.0, 0.0, 1.0], [0.0, 1.0, 1.0, 1.0])
    """
    late = np.asarray(delay, dtype=np.float64)
    lowest = np.ceil((late - (parts.n_symbol - 1)) / parts.n_symbol) + 0.0  # no -0
    highest = np.floor((late + parts.n_useful + parts.n_suffix + n_before) / parts.n_symbol)
    return lowest, highest


def propagate(symbols: ArrayLike, system: System, paths: Paths) -> Complex:
    """Waveform that every element receives of a frame, exact for the continuous waveform sent.

    Parameters
    ----------
    symbols : array_like, shape (n_subcarriers, n_symbols)
        What every resource element carries.
    system : System
    paths : Paths
        Delays up to the duration of the frame.

    Returns
    -------
    ndarray of complex128, shape (n_samples + tail, E)
        At the critical rate, from the instant at which the first prefix starts
        to be sent. The tail holds what the longest delay, in whole samples
        rounded up, adds. The samples of an element lie side by side in memory.

    Raises
    ------
    InputError
        If the grid does not have the system's shape or is not finite, a path is
        longer than the frame, or prefix or suffix are no whole samples.

    Notes
    -----
    The Doppler phase is zero in the middle of the first symbol's useful part,
    (N - 1)/2 samples from its start.

    Examples
    --------
    >>> from isacbench.link.waveform.ofdm import modulate
    >>> from isacbench.model.numerology import System
    >>> system = System(n_subcarriers=32, n_symbols=2)
    >>> grid = np.ones((32, 2))
    >>> late = Paths(np.array([[0.5]]), np.array([3 / system.bandwidth_hz]), np.zeros(1))
    >>> received = propagate(grid, system, late)
    >>> np.allclose(received[3:, 0], 0.5 * modulate(grid, system))
    True
    """
    parts = layout(system)
    frame_s = n_samples(parts, system.n_symbols) / system.bandwidth_hz
    longest_s = float(paths.delay_s.max(initial=0))
    require(longest_s <= frame_s, "paths.delay_s, the longest,", longest_s, f"up to {frame_s:g}, the frame")
    periods = _Periods(symbols, system, paths, n_before=parts.n_prefix)
    n = n_samples(parts, system.n_symbols) + int(np.ceil(periods.delay.max(initial=0)))
    received: Complex = np.empty((paths.gain.shape[1], n), dtype=np.complex128)
    for together in _runs(-(-n // parts.n_symbol), periods.n_together):
        block = periods.samples(together)
        first = together.start * parts.n_symbol
        # Explicit sizes, because -1 cannot be resolved where there are no elements.
        joined = block.transpose(1, 0, 2).reshape(len(received), len(together) * parts.n_symbol)
        received[:, first : first + joined.shape[1]] = joined[:, : n - first]
    return received.T


def received_symbols(symbols: ArrayLike, system: System, paths: Paths) -> Iterator[Complex]:
    """Demodulate what every element receives of a frame, symbol by symbol.

    It is what demodulating `propagate` yields, but the waveform is never held,
    nor are prefixes made that a receiver drops.

    Parameters
    ----------
    symbols : array_like, shape (n_subcarriers, n_symbols)
    system : System
    paths : Paths
        Delays of any length.

    Yields
    ------
    ndarray of complex128, shape (n_subcarriers, E)
        The next symbol; subcarriers of an element lie side by side in memory.

    Raises
    ------
    InputError
        If the grid does not have the system's shape or is not finite, or
        prefix or suffix are no whole samples.
    """
    periods = _Periods(symbols, system, paths, n_before=0)
    return _demodulated(periods, system.n_symbols)


def _demodulated(periods: _Periods, n_symbols: int) -> Iterator[Complex]:
    for together in _runs(n_symbols, periods.n_together):
        yield from (grid.T for grid in periods.spectra(together))


def _runs(n: int, n_together: int) -> Iterator[range]:
    """Consecutive runs of so many of the first n numbers."""
    return (range(first, min(first + n_together, n)) for first in range(0, n, n_together))


class _Periods:
    """Received samples of symbol periods, as one window a period sees them.

    `n_before` samples of each period lie before the useful part: none where a
    demodulator looks, the whole prefix where the windows are to join. Time is
    in samples from the start of a period's useful part throughout.
    """

    def __init__(self, symbols: ArrayLike, system: System, paths: Paths, n_before: int) -> None:
        self.parts = layout(system)
        self.sent = _by_symbol(symbols, system)
        self.delay = delay_samples(paths.delay_s, system)
        # Whole turns a sample leave no trace in samples but the sign that they
        # have at the zero of the phase, which may be midway between two samples.
        turns = paths.doppler_hz / system.bandwidth_hz
        whole = np.rint(turns)
        self.turns = turns - whole
        is_reversed = np.mod(whole, 2) * (self.parts.n_useful - 1) % 2 == 1
        self.gain = np.where(is_reversed[:, None], -paths.gain, paths.gain)
        self.n_before = n_before
        self.n_window = n_before + self.parts.n_useful
        self.n_elements: int = paths.gain.shape[1]

    @property
    def n_together(self) -> int:
        """Periods that are made at a time."""
        n_periods: int = SAMPLES_TOGETHER // max(self.n_elements * self.n_window, 1)
        return max(n_periods, available_cores())

    def samples(self, periods: range) -> Complex:
        """Received samples (periods, E, n_window)."""
        received = self._nothing(len(periods))
        for lag, index in self._of_lags(np.arange(self.delay.size)):
            self._add_paths(received, periods, lag, index)
        return received

    def spectra(self, periods: range) -> Complex:
        """Unitary DFTs (periods, E, n_subcarriers) of the samples; the window is the useful part."""
        spectra = self._moving_spectra(periods)
        if self._standing.size:
            sent = self.sent[periods.start : periods.stop, None, :]
            spectra += sent * self._standing_response
        return spectra

    def _moving_spectra(self, periods: range) -> Complex:
        received = self._nothing(len(periods))
        if self._standing.size == self.delay.size:
            return received
        for index in self._of_crowded_speeds:
            self._add_speed(received, periods, index)
        for lag, index in self._of_lags(self._single):
            self._add_paths(received, periods, lag, index)
        workers = _n_threads(received.size)
        spectra: Complex = scipy.fft.fft(received, axis=2, norm="ortho", overwrite_x=True, workers=workers)
        return spectra

    def _nothing(self, n_periods: int) -> Complex:
        return np.zeros((n_periods, self.n_elements, self.n_window), dtype=np.complex128)

    @cached_property
    def _is_undisturbed(self) -> NDArray[np.bool_]:
        """Of which paths the useful part sees one symbol alone, at full amplitude."""
        undisturbed: NDArray[np.bool_] = self.delay <= self.parts.n_prefix - self.parts.n_suffix
        return undisturbed

    @cached_property
    def _standing(self) -> Index:
        return np.flatnonzero(self._is_undisturbed & (self.turns == 0))

    @cached_property
    def _of_crowded_speeds(self) -> list[Index]:
        """Undisturbed moving paths, speed by speed, where a speed has no fewer of them than elements."""
        index = np.flatnonzero(self._is_undisturbed & (self.turns != 0))
        _, speed, counts = np.unique(self.turns[index], return_inverse=True, return_counts=True)
        return [index[speed == k] for k in np.flatnonzero(counts >= self.n_elements)]

    @cached_property
    def _single(self) -> Index:
        """Paths that are neither."""
        together = np.concatenate([self._standing, *self._of_crowded_speeds])
        return np.setdiff1d(np.arange(self.delay.size), together)

    @cached_property
    def _standing_response(self) -> Complex:
        return self._response(self._standing)

    def _response(self, index: Index) -> Complex:
        """Response (E, n_subcarriers) of some paths, Doppler aside."""
        response: Complex = np.zeros((self.n_elements, self.parts.n_useful), dtype=np.complex128)
        for some in self._in_blocks(index):
            response += self.gain[some].T @ self._ramps(some, lag=0)
        return response

    def _in_blocks(self, index: Index) -> list[Index]:
        n_paths = max(TABLE_VALUES // self.n_window, 1)
        return [index[first : first + n_paths] for first in range(0, index.size, n_paths)]

    def _ramps(self, index: Index, lag: int) -> Complex:
        """Phases (k, n_subcarriers) by which spectra of the symbols sent so many periods before are late."""
        late = np.mod(self.delay[index] - lag * self.parts.n_symbol, self.parts.n_useful)
        return _exponentials(-late / self.parts.n_useful, np.arange(self.parts.n_useful))

    def _doppler(self, turns: Floats) -> Complex:
        """Doppler (k, n_window) within a period; its phase is zero in the middle of the useful part."""
        time = np.arange(self.n_window) - self.n_before - (self.parts.n_useful - 1) / 2
        return _exponentials(turns, time)

    def _of_period(self, turns: Floats, period: int) -> Complex:
        """Doppler (k,) from the first period to another."""
        of_one = turns * self.parts.n_symbol
        return _exponentials(of_one - np.rint(of_one), np.array([period]))[:, 0]

    def _of_lags(self, index: Index) -> Iterator[tuple[int, Index]]:
        """Which of some paths show symbols sent so many periods before."""
        lowest, highest = shown_lags(self.delay[index], self.parts, self.n_before)
        for lag in np.unique(np.concatenate([lowest, lowest + 1, highest])):
            shown = index[(lowest <= lag) & (lag <= highest)]
            if shown.size:
                yield int(lag), shown

    def _window(self, index: Index, lag: int) -> Floats:
        """Transmit window (k, n_window) of symbols sent so many periods before."""
        since = np.arange(self.n_window) - self.n_before + lag * self.parts.n_symbol
        return transmit_window(self.parts, since - self.delay[index, None])

    def _add_paths(self, received: Complex, periods: range, lag: int, index: Index) -> None:
        """Add what paths show of symbols sent so many periods before."""
        shown = range(max(periods.start, lag), min(periods.stop, len(self.sent) + lag))
        for some in self._in_blocks(index) if shown else []:
            ramps, table = self._ramps(some, lag), self._doppler(self.turns[some])
            table *= self._window(some, lag)

            def add(period: int, some: Index = some, ramps: Complex = ramps, table: Complex = table) -> None:
                waves = self._waves(self.sent[period - lag] * ramps)
                waves *= table
                gain = self.gain[some] * self._of_period(self.turns[some], period)[:, None]
                received[period - periods.start] += gain.T @ waves

            _side_by_side(add, shown, table.size)

    def _add_speed(self, received: Complex, periods: range, index: Index) -> None:
        """Add undisturbed paths of one speed, summed before their inverse DFT."""
        response, turns = self._response(index), self.turns[index[:1]]
        doppler = self._doppler(turns)

        def add(period: int) -> None:
            waves = self._waves(self.sent[period] * response)
            waves *= doppler * self._of_period(turns, period)
            received[period - periods.start] += waves

        _side_by_side(add, periods, response.size)

    def _waves(self, spectra: Complex) -> Complex:
        """Periodic waves (k, n_window) of spectra (k, n_subcarriers), which are overwritten."""
        waves: Complex = scipy.fft.ifft(spectra, axis=1, norm="ortho", overwrite_x=True)
        if self.n_before == 0:
            return waves
        return np.concatenate([waves[:, self.parts.n_useful - self.n_before :], waves], axis=1)


def _side_by_side(add: Callable[[int], None], periods: range, n_values: int) -> None:
    """Work on periods of so many values, in several threads; each has samples of its own."""
    n_threads = _n_threads(n_values * len(periods))
    if n_threads == 1:
        for period in periods:
            add(period)
        return
    with threadpool_limits(limits=1), ThreadPoolExecutor(n_threads) as threads:
        for _ in threads.map(add, periods):
            pass


def _n_threads(n_values: int) -> int:
    return 1 if n_values <= FEW_VALUES else available_cores()


def _by_symbol(symbols: ArrayLike, system: System) -> Complex:
    """Grid as (n_symbols, n_subcarriers)."""
    grid = checked_grid(symbols, system)
    require_all("symbols", np.abs(grid), np.isfinite(grid), "finite numbers")
    return np.ascontiguousarray(grid.T)


def _exponentials(turns: Floats, steps: NDArray[np.integer[Any] | np.floating[Any]]) -> Complex:
    """Exponentials exp(j2π turn step), shape (k, steps)."""
    phase = np.multiply.outer(2 * np.pi * turns, steps)
    exponentials: Complex = np.empty(phase.shape, dtype=np.complex128)
    np.cos(phase, out=exponentials.real)
    np.sin(phase, out=exponentials.imag)
    return exponentials
