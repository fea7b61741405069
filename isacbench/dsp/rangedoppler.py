"""Range-Doppler maps of whole resource grids, and gated ones as estimators see them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import prod
from typing import Any

import numpy as np
import scipy.fft
from numpy.lib.stride_tricks import sliding_window_view

from isacbench.checked_arrays import Complex, Integers, checked_array, parts_of
from isacbench.display import short_repr
from isacbench.dsp.angles.aperture import Aperture, Plane
from isacbench.dsp.bursts import SymbolBursts, symbol_bursts, whole_frame
from isacbench.dsp.windows import Window, reach, relative_taper, require_bins, taps
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
        """Choose the window along Doppler: that of a whole frame, or "rect" for bursts.

        Between one grating lobe of bursts and the next there are no sidelobes to lower, and a taper widens
        all lobes until they meet.
        """
        return "rect" if self.sees_lobes else window

    def astype(self, dtype: type[np.complexfloating[Any, Any]]) -> GatedMap:
        """Convert the map to a precision.

        Parameters
        ----------
        dtype : type
            Complex type of numpy.

        Returns
        -------
        GatedMap
            The map itself if it has that precision.
        """
        return self if self.cells.dtype == dtype else replace(self, cells=self.cells.astype(dtype))

    def tapered(
        self, range_window: Window = "rect", doppler_window: Window = "rect", neighbours: int = 0
    ) -> TaperedMap:
        """Taper the map along range and Doppler, without the outermost bins that lack neighbours.

        Along an axis whose last bin is next to its first, all bins have neighbours.

        Parameters
        ----------
        range_window, doppler_window : {"rect", "soft", "hamming", "hann", "blackman"}
        neighbours : int
            Bins that such an axis repeats from its other end, at either end.
        """
        reaches = reach(range_window), reach(doppler_window)
        with stage("rdm"):
            wrapped = self.wrapped(reaches, neighbours)
        for n_bins, window in zip(wrapped.gate.shape, (range_window, doppler_window), strict=True):
            require_bins(n_bins, window)
        windows, gate = (range_window, doppler_window), wrapped.gate.trim(*reaches)
        return TaperedMap(wrapped, windows, gate, self.cells.dtype.type)

    def wrapped(self, reaches: tuple[int, int], neighbours: int = 0) -> GatedMap:
        """Repeat bins from the other end of axes whose last bin is next to their first.

        Parameters
        ----------
        reaches : (int, int)
            Neighbours to either side that a taper mixes in, along range and Doppler.
        neighbours : int
            Bins to repeat beyond these.
        """
        cells, added = self.cells, [0, 0]
        for axis, n_side in enumerate(reaches):
            n_bins = self.gate.shape[axis]
            # `taper` refuses axes shorter than the window.
            if self.gate.wraps[axis] and n_bins > 2 * n_side:
                added[axis] = n_side + neighbours
                index = np.arange(-added[axis], n_bins + added[axis]) % n_bins
                cells = np.take(cells, index, axis=axis)
        return self if added == [0, 0] else replace(self, cells=cells, gate=self.gate.extend(*added))


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

    def astype(self, dtype: type[np.complexfloating[Any, Any]]) -> TaperedMap:
        """Read the cells in a precision."""
        return replace(self, dtype=dtype)

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
        gain = prod(taps(window)[reach(window)] for window in self.windows)
        for some in parts_of(len(kept[0]), CACHED_SAMPLES // cells[0].size - n_more[0]):
            with stage("rdm"):
                block = cells[some.start : some.stop + n_more[0]]
                block = block.astype(self.dtype, order="C")
                parts = block.view(block.real.dtype)
                parts *= gain
                block = relative_taper(block, self.windows[1], axis=1)
                block = relative_taper(block, self.windows[0], axis=0)
            yield block

    def around(self, bins: Bins) -> Complex:
        """Cells (n, 5, *elements) at absolute bins, and the next nearer, farther, slower and faster ones."""
        rows, columns = self.gate.index(bins)
        return self.at(
            rows[:, None] + np.array([0, -1, 1, 0, 0]), columns[:, None] + np.array([0, 0, 0, -1, 1])
        )

    def at(self, rows: Integers, columns: Integers) -> Complex:
        """Tapered cells at indices of the map, each computed once.

        Parameters
        ----------
        rows, columns : ndarray of int64, same shape (...)

        Returns
        -------
        ndarray of complex, shape (..., *elements)
        """
        source = self.untapered.cells
        n_columns, elements = self.gate.shape[1], source.shape[2:]
        index, where = np.unique(rows * n_columns + columns, return_inverse=True)
        row, column = np.divmod(index, n_columns)
        weights = np.multiply.outer(*map(taps, self.windows))
        parts = np.ascontiguousarray(source).reshape(*source.shape[:2], -1).view(source.real.dtype)
        around = sliding_window_view(parts, weights.shape, axis=(0, 1)).transpose(0, 1, 3, 4, 2)
        tapered = np.empty((index.size, prod(elements)), self.dtype)
        for some in parts_of(index.size, CACHED_SAMPLES // (weights.size * prod(elements))):
            taken = around[row[some], column[some]].reshape(len(row[some]), weights.size, -1)
            tapered[some] = (weights.ravel().astype(parts.dtype) @ taken).view(source.dtype)
        return tapered[where].reshape(*rows.shape, *elements)
