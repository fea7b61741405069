"""Propagation of the waveform: delayed and Doppler-shifted copies of it, many at once.

The waveform is continuous in time, and so are delays. A symbol delayed by τ is the
inverse DFT of its spectrum times exp(-j2π nΔf τ), times the transmit window at the
delayed instants: its samples are exact for any delay. Doppler rotates their phase
along the time axis of the whole frame.

Received samples are computed one symbol period after another. In each period a path
contributes the symbol sent in it and, if it is late, those sent before. These
contributions are the same in all periods, up to a phase rotation by Doppler, so that
tables are made for many periods at a time. Most work is saved where the receiver's
window holds a single undisturbed symbol of a path: paths without Doppler are then a
factor on the spectrum, and paths of equal speed are summed before their inverse DFT.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy.fft

from isacbench.cores import available_cores, one_blas_thread
from isacbench.errors import InputError, require
from isacbench.link.waveform.ofdm import checked_grid, layout, n_samples, transmit_window
from isacbench.model.frozen_arrays import freeze_arrays
from isacbench.model.number_limits import require_all

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import ArrayLike, NDArray

    from isacbench.link.waveform.ofdm import SymbolLayout
    from isacbench.model.numerology import System

    Complex = NDArray[np.complex128]
    Floats = NDArray[np.float64]
    Index = NDArray[np.intp]

SAMPLES_TOGETHER = 2**23
"""Largest number of received samples of all elements computed at a time: 128 MB."""

TABLE_VALUES = 2**19
"""Largest number of values in a table of paths and samples: 8 MB."""

WHOLE = 4 * np.finfo(np.float64).eps
"""Relative distance up to which a delay counts as a whole number of samples: rounding of seconds."""


@dataclass(frozen=True, eq=False)
class Paths:
    """Propagation paths from the transmitter to every receiving element.

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
        Rounded to whole numbers where they differ by rounding only, because
        windows without a suffix have abrupt ends.
    """
    delay = np.asarray(delay_s, dtype=np.float64) * system.bandwidth_hz
    whole = np.rint(delay)
    return np.where(np.abs(delay - whole) <= WHOLE * whole, whole, delay)


def shown_lags(delay: ArrayLike, parts: SymbolLayout, n_before: int = 0) -> tuple[Floats, Floats]:
    """Find which transmitted symbols fall into a receiver's window through late echoes.

    Parameters
    ----------
    delay : array_like, any shape
        In samples.
    parts : SymbolLayout
    n_before : int
        Number of samples by which the window begins before the useful part; it
        ends with the useful part.

    Returns
    -------
    lowest, highest : ndarray of float64, same shape
        Latest and earliest symbol that may contribute, counted in symbol periods
        back from the present one.

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
        Transmitted symbol of every resource element.
    system : System
    paths : Paths
        Delays up to the duration of the frame.

    Returns
    -------
    ndarray of complex128, shape (n_samples + tail, E)
        Sampled at the critical rate, from the start of transmission of the first
        prefix. The tail is the longest delay, rounded up to whole samples. The
        samples of an element are adjacent in memory.

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
    receiver = _Receiver(symbols, system, paths, demodulates=False)
    n = n_samples(parts, system.n_symbols) + int(np.ceil(receiver.delay.max(initial=0)))
    n_periods = -(-n // parts.n_symbol)
    received: Complex = np.empty((paths.gain.shape[1], n_periods, parts.n_symbol), dtype=np.complex128)
    for together in receiver.runs(n_periods):
        received[:, together.start : together.stop] = receiver.samples(together).swapaxes(0, 1)
    return received.reshape(len(received), n_periods * parts.n_symbol)[:, :n].T


def received_symbols(symbols: ArrayLike, system: System, paths: Paths) -> Iterator[Complex]:
    """Demodulate what every element receives of a frame, symbol by symbol.

    The result equals demodulating the output of `propagate`. The waveform is
    never held in memory, and prefixes that a receiver drops are not computed.

    Parameters
    ----------
    symbols : array_like, shape (n_subcarriers, n_symbols)
    system : System
    paths : Paths
        Delays of any length.

    Yields
    ------
    ndarray of complex128, shape (n_subcarriers, E)
        The next symbol; subcarriers of an element are adjacent in memory.

    Raises
    ------
    InputError
        If the grid does not have the system's shape or is not finite, or
        prefix or suffix are no whole samples.
    """
    receiver = _Receiver(symbols, system, paths, demodulates=True)
    return (
        spectrum.T for together in receiver.runs(system.n_symbols) for spectrum in receiver.spectra(together)
    )


class _Waves(NamedTuple):
    """Waves in the receiver's window of every period, from the symbol sent `lag` periods before.

    Attributes
    ----------
    lag : int
    spectrum : ndarray of complex128, shape (k, n_subcarriers)
        Factors on the symbol's spectrum.
    table : ndarray of complex128, shape (k, n_window) or (1, n_window)
        Factors on the samples: transmit window, and Doppler within a period.
    turns : ndarray of float64, shape (k,) or (1,)
        Doppler in turns per sample.
    gain : ndarray of complex128, shape (k, E), or None
        Amplitude of each wave at each element; None if there is one wave per element.
    """

    lag: int
    spectrum: Complex
    table: Complex
    turns: Floats
    gain: Complex | None


class _Receiver:
    """Windows of received samples, one for each symbol period.

    A demodulator's window is the useful part. Other windows begin with the
    prefix, so that they join without gaps. Time is always in samples from the
    start of a period's useful part.
    """

    def __init__(self, symbols: ArrayLike, system: System, paths: Paths, *, demodulates: bool) -> None:
        self.parts = layout(system)
        self.sent = np.ascontiguousarray(checked_grid(symbols, system).T)
        self.delay = delay_samples(paths.delay_s, system)
        self.turns = paths.doppler_hz / system.bandwidth_hz
        self.gain = paths.gain
        self.n_before = 0 if demodulates else self.parts.n_prefix
        self.time = np.arange(-self.n_before, self.parts.n_useful)
        self.n_elements: int = paths.gain.shape[1]
        # Paths of which a demodulator's window holds a single symbol at full amplitude.
        is_undisturbed = demodulates & (self.delay <= self.parts.n_prefix - self.parts.n_suffix)
        standing = np.flatnonzero(is_undisturbed & (self.turns == 0))
        self.standing = self._response(standing)
        moving = np.flatnonzero(is_undisturbed & (self.turns != 0))
        _, speed, counts = np.unique(self.turns[moving], return_inverse=True, return_counts=True)
        # Paths of one speed are summed where that leaves fewer waves.
        self.crowds = [moving[speed == k] for k in np.flatnonzero(counts >= self.n_elements)]
        self.single = np.setdiff1d(np.arange(self.delay.size), np.concatenate([standing, *self.crowds]))

    def runs(self, n_periods: int) -> Iterator[range]:
        """Consecutive runs of periods that are computed together."""
        n_together = max(SAMPLES_TOGETHER // max(self.n_elements * self.time.size, 1), 1)
        for first in range(0, n_periods, n_together):
            yield range(first, min(first + n_together, n_periods))

    @one_blas_thread()
    def samples(self, periods: range) -> Complex:
        """Received samples (periods, E, n_window), without the paths in `standing`."""
        received = np.zeros((len(periods), self.n_elements, self.time.size), dtype=np.complex128)
        for waves in self._waves():
            first, last = max(periods.start, waves.lag), min(periods.stop, len(self.sent) + waves.lag)
            for period in range(first, last):
                received[period - periods.start] += self._arriving(waves, period)
        return received

    def spectra(self, periods: range) -> Complex:
        """Unitary DFTs (periods, E, n_subcarriers) of all samples; the window is the useful part."""
        samples = self.samples(periods)
        spectra: Complex = scipy.fft.fft(samples, axis=2, norm="ortho", workers=available_cores())
        spectra += self.sent[periods.start : periods.stop, None, :] * self.standing
        return spectra

    def _waves(self) -> Iterator[_Waves]:
        """Waves of crowds (paths of equal speed), then those of single paths in blocks."""
        for crowd in self.crowds:
            turns = self.turns[crowd[:1]]
            yield _Waves(0, self._response(crowd), self._doppler(turns), turns, None)
        lowest, highest = shown_lags(self.delay, self.parts, self.n_before)
        for lag in np.unique(np.concatenate([lowest, lowest + 1, highest])).astype(int).tolist():
            is_shown = (lowest[self.single] <= lag) & (lag <= highest[self.single])
            for some in self._blocks(self.single[is_shown]):
                table = self._doppler(self.turns[some])
                table *= transmit_window(
                    self.parts, self.time + lag * self.parts.n_symbol - self.delay[some, None]
                )
                yield _Waves(lag, self._ramps(some, lag), table, self.turns[some], self.gain[some])

    def _arriving(self, waves: _Waves, period: int) -> Complex:
        """Received samples (E, n_window) of waves in a period."""
        spectrum = self.sent[period - waves.lag] * waves.spectrum
        useful = scipy.fft.ifft(spectrum, axis=1, norm="ortho", workers=available_cores())
        samples: Complex = useful if self.n_before == 0 else useful[:, self.time]
        turned = np.exp(2j * np.pi * waves.turns * self.parts.n_symbol * period)[:, None]
        if waves.gain is None:
            samples *= waves.table * turned
            return samples
        samples *= waves.table
        at_elements: Complex = (waves.gain * turned).T @ samples
        return at_elements

    def _response(self, index: Index) -> Complex:
        """Frequency response (E, n_subcarriers) of several paths together, without Doppler."""
        response: Complex = np.zeros((self.n_elements, self.parts.n_useful), dtype=np.complex128)
        for some in self._blocks(index):
            response += self.gain[some].T @ self._ramps(some, lag=0)
        return response

    def _blocks(self, index: Index) -> Iterator[Index]:
        n_together = max(TABLE_VALUES // self.time.size, 1)
        return (index[first : first + n_together] for first in range(0, index.size, n_together))

    def _ramps(self, index: Index, lag: int) -> Complex:
        """Phase ramps (k, n_subcarriers) that delay the spectra of symbols sent `lag` periods before."""
        late = np.mod(self.delay[index] - lag * self.parts.n_symbol, self.parts.n_useful)
        return _exponentials(-late / self.parts.n_useful, np.arange(self.parts.n_useful))

    def _doppler(self, turns: Floats) -> Complex:
        """Doppler (k, n_window) within a period; its phase is zero in the middle of the useful part."""
        return _exponentials(turns, self.time - (self.parts.n_useful - 1) / 2)


def _exponentials(turns: Floats, steps: NDArray[np.integer | np.floating]) -> Complex:
    """Exponentials exp(j2π turn step), shape (k, steps)."""
    exponentials: Complex = np.exp(2j * np.pi * np.multiply.outer(turns, steps))
    return exponentials
