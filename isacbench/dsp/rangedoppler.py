"""Range-Doppler maps of whole resource grids, and gated ones as estimators see them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.fft

from isacbench.checked_arrays import Complex, checked_array, parts_of
from isacbench.display import short_repr
from isacbench.dsp.angles.aperture import Aperture, Plane
from isacbench.dsp.bursts import SymbolBursts, symbol_bursts, whole_frame
from isacbench.dsp.windows import Window, reach, require_bins, taper, taps
from isacbench.instrument.stages import stage
from isacbench.model.gate import Bins, Gate
from isacbench.model.observation import Observation

CACHED_SAMPLES = 2**16
"""Samples of cells that stay in the cache together with what is computed from them."""

WHOLE = slice(None), slice(None)
"""All range and Doppler bins."""


def range_doppler_map(grid: Complex) -> Complex:
    """Unitary inverse DFT over subcarriers and unitary DFT over symbols, so that noise keeps its power.

    Parameters
    ----------
    grid : ndarray of complex, shape (n_subcarriers, n_symbols, ...)
        Echo divided by the transmitted symbols.

    Returns
    -------
    ndarray of complex, same shape and precision
        Range bins by Doppler bins; Doppler bin d < 0 stands at index
        n_symbols + d.
    """
    ranges = scipy.fft.ifft(grid, axis=0, norm="ortho", workers=-1)
    return scipy.fft.fft(ranges, axis=1, norm="ortho", workers=-1, overwrite_x=True)


@dataclass(frozen=True, eq=False)
class GatedMap:
    """Range-Doppler cells of virtual elements, and the bins that they stand for.

    Attributes
    ----------
    cells : ndarray of complex128 or complex64, shape (n_range, n_doppler, *elements)
        Elements (P, Q), or those of `elements`.
    elements : Aperture, optional
        The elements that the cells hold; without it a plane.
    bursts : SymbolBursts, optional
        Symbols of the cells, which are referred to the middle of these symbols
        (`SymbolBursts.centred`); without it the whole frame.
    """

    cells: Complex
    gate: Gate
    elements: Aperture | None = None
    bursts: SymbolBursts | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        object.__setattr__(self, "cells", checked_array("cells", self.cells, np.complex64))

    @classmethod
    def of(cls, observation: Observation, cells: Complex, elements: Aperture | None = None) -> GatedMap:
        """Map of an observation.

        Parameters
        ----------
        cells : ndarray of complex, shape (n_range, n_doppler, *elements)
            Its cells, in any unit.
        elements : Aperture, optional
            The elements that the cells hold; without it a plane.

        Returns
        -------
        GatedMap
            Referred to the middle of the symbols that were sensed with.

        Raises
        ------
        InputError
            If the kernel of these symbols is not known (`symbol_bursts`).
        """
        gate, bursts = observation.gate, symbol_bursts(observation.system, observation.sensing)
        return cls(bursts.centred(cells, gate.doppler_bins), gate, elements, bursts)

    @property
    def aperture(self) -> Aperture:
        """The elements that the cells hold."""
        return Plane(*self.cells.shape[2:]) if self.elements is None else self.elements

    @property
    def n_elements(self) -> int:
        """Virtual elements that the cells hold."""
        return self.aperture.n_elements

    @property
    def sees_lobes(self) -> bool:
        """True if echoes show in Doppler bins far from their own."""
        return self.bursts is not None and not self.bursts.is_whole_frame

    def doppler_kernel(self, n_symbols: int) -> SymbolBursts:
        """Kernel of an echo along Doppler.

        Parameters
        ----------
        n_symbols : int
            Symbols of the frame.
        """
        return whole_frame(n_symbols) if self.bursts is None else self.bursts

    def doppler_taper(self, window: Window) -> Window:
        """Choose the window along Doppler: that of a whole frame, or "rect" for bursts far from each other.

        Between one grating lobe of these and the next there are no sidelobes to lower, and a taper widens
        all lobes until they meet.
        """
        return window if self.bursts is None or self.bursts.are_dense else "rect"

    def tapered(
        self,
        range_window: Window = "rect",
        doppler_window: Window = "rect",
        neighbours: int = 0,
        dtype: type[np.complexfloating[Any, Any]] = np.complex128,
    ) -> TaperedMap:
        """Taper the map along range and Doppler, without the outermost bins that lack neighbours.

        Along an axis whose last bin is next to its first, all bins have neighbours.

        Parameters
        ----------
        range_window, doppler_window : {"rect", "soft", "hamming", "hann", "blackman"}
        neighbours : int
            Bins that such an axis repeats from its other end, at either end.
        dtype : type
            Precision of the tapered cells.
        """
        windows = range_window, doppler_window
        for n_bins, window in zip(self.gate.shape, windows, strict=True):
            require_bins(n_bins, window)
        reaches = reach(range_window), reach(doppler_window)
        repeated = [(n + neighbours) * wraps for n, wraps in zip(reaches, self.gate.wraps, strict=True)]
        untapered = self
        if any(repeated):
            n_added = *repeated, *(0 for _ in self.cells.shape[2:])
            with stage("rdm"):
                cells = np.pad(self.cells, [(n, n) for n in n_added], mode="wrap")
            untapered = replace(self, cells=cells, gate=self.gate.extend(*repeated))
        return TaperedMap(untapered, windows, untapered.gate.extend(-reaches[0], -reaches[1]), dtype)


@dataclass(frozen=True, eq=False)
class TaperedMap:
    """Range-Doppler map whose cells are tapered where they are read.

    Attributes
    ----------
    untapered : GatedMap
        With the neighbours that the windows mix in.
    windows : (Window, Window)
        Along range and along Doppler.
    gate : Gate
        Bins of the tapered map.
    dtype : type
        Precision of the cells that are read.
    """

    untapered: GatedMap
    windows: tuple[Window, Window]
    gate: Gate
    dtype: type[np.complexfloating[Any, Any]]

    __repr__ = short_repr

    @property
    def aperture(self) -> Aperture:
        """The elements that the cells hold."""
        return self.untapered.aperture

    @property
    def sees_lobes(self) -> bool:
        """True if echoes show in Doppler bins far from their own."""
        return self.untapered.sees_lobes

    @property
    def cells(self) -> Complex:
        """All cells, shape (n_range, n_doppler, *elements)."""
        return np.concatenate([*self.blocks()])

    def blocks(self, part: tuple[slice, slice] = WHOLE) -> Iterator[Complex]:
        """Cells of some range bins after the other, which stay in the cache while they are used.

        `part` are the range and Doppler bins, as slices of the map.
        """
        kept = [range(*one.indices(n)) for one, n in zip(part, self.gate.shape, strict=True)]
        n_more = [2 * reach(window) for window in self.windows]
        rows, columns = (slice(bins.start, bins.stop + n) for bins, n in zip(kept, n_more, strict=True))
        cells = self.untapered.cells[rows, columns]
        for some in parts_of(len(kept[0]), CACHED_SAMPLES // cells[0].size - n_more[0]):
            with stage("rdm"):
                block = cells[some.start : some.stop + n_more[0]]
                # Along range first, to which blocks have more bins than are kept.
                block = taper(block.astype(self.dtype, copy=False), self.windows[0], axis=0)
                block = taper(block, self.windows[1], axis=1)
            yield block

    def around(self, bins: Bins) -> Complex:
        """Cells (n, 5, *elements) at absolute bins, and the next nearer, farther, slower and faster ones."""
        source, n_columns = self.untapered.cells, self.gate.shape[1]
        row, column = self.gate.index(bins)
        cell = (row * n_columns + column)[:, None] + np.array([0, -n_columns, n_columns, -1, 1])
        # Neighbours share cells, each of which is computed once.
        once, where = np.unique(cell, return_inverse=True)
        row, column = np.divmod(once, n_columns)
        weights = np.multiply.outer(*map(taps, self.windows))
        tapered = np.empty((once.size, *source.shape[2:]), self.dtype)
        for some in parts_of(once.size, CACHED_SAMPLES // (weights.size * source[0, 0].size)):
            tapered[some] = sum(
                weight * source[row[some] + i, column[some] + k] for (i, k), weight in np.ndenumerate(weights)
            )
        return tapered[where].reshape(*cell.shape, *source.shape[2:])
