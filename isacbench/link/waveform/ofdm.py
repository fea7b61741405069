"""CP-OFDM: the waveform of a resource grid, and the grid of a waveform."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import ArrayLike

from isacbench.checked_arrays import Complex, Floats, checked_array
from isacbench.errors import InputError
from isacbench.model.number_limits import require_count
from isacbench.model.numerology import System

WHOLE = 1e-9
"""Largest distance of a prefix or suffix from whole samples, as a fraction of the useful part: rounding."""


@dataclass(frozen=True)
class SymbolLayout:
    """Samples that the parts of an OFDM symbol have.

    Attributes
    ----------
    n_useful : int
        Useful part, 1/Δf.
    n_prefix : int
        Cyclic prefix before it.
    n_suffix : int
        Cyclic suffix behind it, which overlaps the next prefix; at most as long
        as the prefix.
    """

    n_useful: int
    n_prefix: int
    n_suffix: int

    @property
    def n_symbol(self) -> int:
        """Samples from the start of a symbol to that of the next."""
        return self.n_prefix + self.n_useful


def layout(system: System, oversampling: int = 1) -> SymbolLayout:
    """Count the samples of an OFDM symbol.

    Parameters
    ----------
    oversampling : int
        Sampling rate over the critical one, N Δf.

    Raises
    ------
    InputError
        If prefix or suffix are no whole number of samples, or the suffix is
        longer than the prefix and would reach the next useful part.

    Examples
    --------
    >>> from isacbench.model.numerology import System
    >>> layout(System())
    SymbolLayout(n_useful=2048, n_prefix=512, n_suffix=64)
    """
    require_count("oversampling", oversampling)
    n_useful = system.n_subcarriers * oversampling
    n_prefix = _whole_samples("cyclic_prefix_ratio", system.cyclic_prefix_ratio, n_useful)
    n_suffix = _whole_samples("cyclic_suffix_ratio", system.cyclic_suffix_ratio, n_useful)
    if n_suffix > n_prefix:
        raise InputError(
            f"cyclic_suffix_ratio = {system.cyclic_suffix_ratio!r}: allowed is up to cyclic_prefix_ratio"
            f" {system.cyclic_prefix_ratio!r}, because the suffix overlaps the next prefix"
        )
    return SymbolLayout(n_useful, n_prefix, n_suffix)


def checked_grid(symbols: ArrayLike, system: System) -> Complex:
    """Convert symbols to an array, and refuse another shape than the system's, and what is not finite."""
    grid = checked_array("symbols", symbols, np.complex128)
    shape = system.n_subcarriers, system.n_symbols
    if grid.shape != shape:
        raise InputError(f"symbols of shape {grid.shape}: allowed is {shape}, subcarriers by symbols")
    _require_finite("symbols hold", grid)
    return grid


def n_samples(layout: SymbolLayout, n_symbols: int) -> int:
    """Count the samples of a frame, with the suffix of its last symbol."""
    return n_symbols * layout.n_symbol + layout.n_suffix


def transmit_window(layout: SymbolLayout, position: ArrayLike) -> Floats:
    """Evaluate the window that a symbol is sent through.

    It rises as a raised cosine at the start of the prefix, over the length of
    the suffix, is 1 up to the end of the useful part, and falls over the
    suffix. Windows of successive symbols sum to 1.

    Parameters
    ----------
    position : array_like, any shape
        In samples from the start of the useful part, not necessarily whole.

    Returns
    -------
    ndarray of float64, same shape
        From 0 to 1. Without a suffix 1 from the start of the prefix to before
        the end of the useful part.
    """
    position = np.asarray(position, dtype=np.float64)
    since_start, since_end = position + layout.n_prefix, position - layout.n_useful
    if layout.n_suffix == 0:
        return ((since_start >= 0) & (since_end < 0)).astype(np.float64)
    return _rise(since_start / layout.n_suffix) - _rise(since_end / layout.n_suffix)


def modulate(symbols: ArrayLike, system: System, oversampling: int = 1) -> Complex:
    """Modulate a resource grid onto its waveform.

    At the time t from the start of its useful part, symbol m is
    N^(-1/2) Σ_n X[n, m] exp(j2π n Δf t), times the transmit window. A sample
    has the mean power of a resource element, at any sampling rate.

    Parameters
    ----------
    symbols : array_like, shape (n_subcarriers, n_symbols)
        What every resource element carries. It is fastest where the
        subcarriers of a symbol lie side by side in memory.
    oversampling : int
        Sampling rate over the critical one, N Δf.

    Returns
    -------
    ndarray of complex128, shape (n_samples,)
        From the start of the first prefix to the end of the last suffix.

    Raises
    ------
    InputError
        If the grid does not have the shape of the system or is not finite, or
        `layout` refuses the system.

    References
    ----------
    3GPP TS 38.211, 5.3.1; the window is left to the transmitter there.

    Examples
    --------
    >>> from isacbench.model.numerology import System
    >>> system = System(n_subcarriers=32, n_symbols=2)
    >>> grid = np.ones((32, 2))
    >>> np.allclose(demodulate(modulate(grid, system), system), grid)
    True
    """
    parts = layout(system, oversampling)
    sent = np.sqrt(oversampling) * checked_grid(symbols, system).T
    useful = scipy.fft.ifft(sent, parts.n_useful, axis=1, norm="ortho")
    waveform: Complex = np.empty(n_samples(parts, system.n_symbols), dtype=np.complex128)
    frame, tail = np.split(waveform, [system.n_symbols * parts.n_symbol])
    by_symbol = frame.reshape(system.n_symbols, parts.n_symbol)
    by_symbol[:, parts.n_prefix :] = useful
    by_symbol[:, : parts.n_prefix] = useful[:, parts.n_useful - parts.n_prefix :]
    # Prefixes rise while the suffixes of the symbols before them fall, the last one into the tail.
    rising = transmit_window(parts, np.arange(parts.n_suffix) - parts.n_prefix)
    suffixes = useful[:, : parts.n_suffix] * (1 - rising)
    by_symbol[:, : parts.n_suffix] *= rising
    by_symbol[1:, : parts.n_suffix] += suffixes[:-1]
    tail[:] = suffixes[-1]
    return waveform


def demodulate(waveform: ArrayLike, system: System) -> Complex:
    """Demodulate a waveform, sampled critically, to its resource grid.

    Parameters
    ----------
    waveform : array_like, shape (n, *trailing)
        From the start of the first prefix at least to the end of the last
        useful part; what follows is not looked at. Trailing axes, such as of
        array elements, are demodulated each.

    Returns
    -------
    ndarray of complex128, shape (n_subcarriers, n_symbols, *trailing)
        The subcarriers of a symbol lie side by side in memory where there are
        no trailing axes.

    Raises
    ------
    InputError
        If there are too few samples or some are not finite, or `layout`
        refuses the system.
    """
    parts = layout(system)
    received = checked_array("waveform", waveform, np.complex128)
    n_least = system.n_symbols * parts.n_symbol
    if received.ndim == 0 or len(received) < n_least:
        raise InputError(f"waveform of shape {received.shape}: allowed are {n_least} samples or more")
    by_symbol = received[:n_least].reshape(system.n_symbols, parts.n_symbol, *received.shape[1:])
    useful = by_symbol[:, parts.n_prefix :]
    _require_finite("waveform holds", useful)
    return scipy.fft.fft(useful, axis=1, norm="ortho").swapaxes(0, 1)


def _whole_samples(name: str, ratio: float, n_useful: int) -> int:
    """Samples of a prefix or suffix, a fraction of the useful part."""
    n = round(ratio * n_useful)
    if abs(ratio * n_useful - n) > WHOLE * n_useful:
        raise InputError(
            f"{name} = {ratio!r}: allowed is a whole number of samples over the {n_useful} of the useful part"
        )
    return n


def _rise(place: Floats) -> Floats:
    """Raised cosine from 0 at place 0 to 1 at place 1, and on."""
    return (1 - np.cos(np.pi * np.clip(place, 0, 1))) / 2


def _require_finite(what: str, values: Complex) -> None:
    if not np.isfinite(values).all():
        raise InputError(f"{what} values that are not finite; allowed are finite numbers")
