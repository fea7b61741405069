"""Doppler kernel of an echo that is sensed in bursts of symbols: grating lobes under an envelope.

With B bursts of L successive symbols that start every P symbols, the response to
an echo x of N Doppler bins away, referred to the middle of the bursts, is

    sin(π B P x/N) / (B sin(π P x/N))  ·  sin(π L x/N) / (L sin(π x/N)),

a Dirichlet kernel of the bursts, which repeats every N/P bins, times that of
one burst. A frame sensed as a whole is one burst of all its symbols.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from isacbench.checked_arrays import Complex, Floats
from isacbench.choices import Sensing
from isacbench.errors import InputError
from isacbench.model.kernels import dirichlet_slopes
from isacbench.model.numerology import System, resource_elements

PLACE_ERROR_BINS = 0.5
"""Error of the distance of two peaks that are read twice a bin."""

DENSE_LOBES = 12.0
"""Bins between the grating lobes of dense bursts, at least: two mainlobes of the widest window."""

OFFSETS = 513
"""Offsets of an echo from a bin at which the kernel is tabulated."""


@dataclass(frozen=True)
class SymbolBursts:
    """Evenly spaced bursts of symbols, as long as each other.

    Attributes
    ----------
    n_symbols : int
        Of the frame: transform length.
    first : int
        First symbol of the first burst.
    length : int
        Symbols of a burst.
    spacing : int
        Symbols from the start of a burst to that of the next.
    """

    n_symbols: int
    first: int
    length: int
    n_bursts: int = 1
    spacing: int = 0

    @property
    def is_whole_frame(self) -> bool:
        """True if all symbols are sensed with: noise is then white, and echoes have one mainlobe."""
        return self.length == self.n_symbols

    @property
    def are_dense(self) -> bool:
        """True if a taper acts on them as on a whole frame: they span it, with lobes far from each other."""
        spanned = (self.n_bursts + 1) * self.spacing > self.n_symbols
        return self.is_whole_frame or (spanned and self.lobe_period >= DENSE_LOBES)

    @property
    def delay_symbols(self) -> float:
        """Symbols from the middle of the bursts to that of the frame."""
        last = self.first + (self.n_bursts - 1) * self.spacing + self.length - 1
        return (self.n_symbols - 1 - self.first - last) / 2

    @property
    def redundancy(self) -> float:
        """Doppler bins per sensed symbol: so many bins hold the same noise."""
        return self.n_symbols / (self.n_bursts * self.length)

    @property
    def lobe_period(self) -> float:
        """Doppler bins from an echo to its grating lobes; infinite for a single burst."""
        return self.n_symbols / self.spacing if self.n_bursts > 1 else np.inf

    @property
    def with_equal_lobes(self) -> SymbolBursts:
        """Bursts of one symbol each, whose grating lobes equal their peak; a single burst as it is."""
        return replace(self, length=1) if self.n_bursts > 1 else self

    def centred(self, cells: Complex, doppler_bins: ArrayLike) -> Complex:
        """Refer cells to the middle of the bursts instead of the frame's.

        Then tapers act on the bursts symmetrically, and kernels are real but
        for the phase that those of a whole frame have.

        Parameters
        ----------
        cells : ndarray of complex, shape (n_range, n_doppler, *elements)
        doppler_bins : array_like of int, shape (n_doppler,)

        Returns
        -------
        ndarray of complex, same shape and precision
            The array itself where both middles are the same.
        """
        if self.delay_symbols == 0:
            return cells
        turns = np.asarray(doppler_bins) * self.delay_symbols / self.n_symbols
        phase = np.exp(-2j * np.pi * turns).astype(np.result_type(np.complex64, cells))
        return cells * phase.reshape(-1, *(1,) * (cells.ndim - 2))

    def response(self, bins: ArrayLike, places: ArrayLike) -> Complex:
        """Response of the bins of a unitary DFT to unit exponentials at fractional bins, centred.

        Parameters
        ----------
        bins : array_like, shape (b,)
        places : array_like, shape (k,)

        Returns
        -------
        ndarray of complex128, shape (b, k)
            √n_symbols at the exponential itself, as of a whole frame.
        """
        n = self.n_symbols
        distance = np.asarray(bins, dtype=np.float64)[:, None] - np.asarray(places, dtype=np.float64)
        phase = np.exp(-1j * np.pi * (n - 1) / n * distance)
        return np.sqrt(n) * self.slopes(distance, 0)[0] * phase

    def slopes(self, distance: ArrayLike, order: int = 2) -> tuple[Floats, ...]:
        """Kernel referred to the middle of the bursts, and its first two derivatives.

        Parameters
        ----------
        distance : array_like, any shape
            In bins.
        order : {0, 2}
            0 for the kernel alone.

        Returns
        -------
        tuple of ndarray of float64, each of the same shape
            1 at distance 0, and the derivatives per bin.

        Examples
        --------
        Bursts a quarter of the frame apart repeat every fourth bin, upside down.

        >>> quarters = SymbolBursts(n_symbols=224, first=1, length=12, n_bursts=4, spacing=56)
        >>> quarters.slopes([0.0, 4.0])[0].round(3).tolist()
        [1.0, -0.927]
        """
        distance = np.asarray(distance, dtype=np.float64)
        one = self._stretched(distance, self.length, self.length, order)
        if self.n_bursts == 1:
            return one
        other = self._stretched(distance, self.n_bursts * self.spacing, self.n_bursts, order)
        if not order:
            return (one[0] * other[0],)
        (f, f1, f2), (g, g1, g2) = one, other
        return f * g, f * g1 + f1 * g, f * g2 + 2 * f1 * g1 + f2 * g

    def sidelobe_drop(self, distance: Floats) -> Floats:
        """Least ratio, 1 and more, of a kernel's peak to its amplitude at a distance in bins.

        Of bursts, the envelope is taken half a bin nearer: peaks are read there.
        """
        if self.is_whole_frame:
            return np.maximum(np.pi * np.abs(distance), 1)
        angle = np.pi / self.n_symbols * np.maximum(np.abs(distance) - PLACE_ERROR_BINS, 0)
        drop: Floats = np.maximum(self.length * np.abs(np.sin(angle)), 1)
        if self.n_bursts > 1:
            drop *= np.maximum(np.pi * self.to_lobe(np.abs(distance)), 1)
        return drop

    def fractional_bin(self, own: Floats, other: Floats) -> Floats:
        """Offset of an echo from its strongest bin towards the next, 0 to 1, by the amplitudes in both."""
        offsets = np.linspace(0, 1, OFFSETS)
        kernel = np.abs(self.slopes(offsets, 0)[0])
        share = np.divide(other, own + other, out=np.zeros_like(own), where=own + other > 0)
        return np.interp(share, kernel[::-1] / (kernel + kernel[::-1]), offsets)

    def to_lobe(self, distance: Floats) -> Floats:
        """Distance from the nearest mainlobe or grating lobe, for a distance from the mainlobe in bins."""
        if self.n_bursts == 1:
            return distance
        return np.abs(distance - self.lobe_period * np.rint(distance / self.lobe_period))

    def _stretched(self, distance: Floats, span: int, n: int, order: int) -> tuple[Floats, ...]:
        """Dirichlet kernel of n samples that span so many symbols, and its first two derivatives."""
        rate = span / self.n_symbols
        slopes = dirichlet_slopes(rate * distance, n, order)
        return tuple(rate**k * slope for k, slope in enumerate(slopes))


@lru_cache(maxsize=8)
def whole_frame(n_symbols: int) -> SymbolBursts:
    """All symbols of a frame as one burst."""
    return SymbolBursts(n_symbols, 0, n_symbols)


@lru_cache(maxsize=8)
def symbol_bursts(system: System, sensing: Sensing) -> SymbolBursts:
    """Bursts of symbols that are sensed with.

    Refused where no symbol is, or where bursts differ in length or spacing, which gives another kernel.
    """
    if sensing == "all":
        return whole_frame(system.n_symbols)
    sensed = np.concatenate([[False], resource_elements(system, sensing).any(axis=0), [False]])
    edges = np.flatnonzero(np.diff(sensed.astype(np.int8)))
    starts, lengths = edges[::2], edges[1::2] - edges[::2]
    even = starts.size > 0 and np.unique(lengths).size == 1 and np.unique(np.diff(starts)).size <= 1
    if not even:
        raise InputError(
            f"system.n_symbols = {system.n_symbols}, sensing = {sensing!r}: bursts must have equal lengths "
            f"and equal spacing; this frame has bursts of {lengths.tolist()} symbols"
        )
    spacing = int(starts[1] - starts[0]) if starts.size > 1 else 0
    return SymbolBursts(system.n_symbols, int(starts[0]), int(lengths[0]), starts.size, spacing)
