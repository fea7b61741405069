"""Range-Doppler maps of whole resource grids, and gated ones as estimators see them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.fft

from isacbench.checked_arrays import Complex, Integers, Mask, checked_array
from isacbench.display import short_repr
from isacbench.dsp.angles.aperture import Aperture, Plane
from isacbench.dsp.bursts import SymbolBursts, symbol_bursts, whole_frame
from isacbench.dsp.windows import Window, reach, taper
from isacbench.instrument.stages import stage
from isacbench.model.gate import Gate
from isacbench.model.observation import Observation

Bins = tuple[Integers, Integers]


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

    def tapered(self, range_window: Window, doppler_window: Window, neighbours: int = 0) -> GatedMap:
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
            cells = taper(taper(wrapped.cells, range_window, axis=0), doppler_window, axis=1)
        return replace(self, cells=cells, gate=wrapped.gate.trim(*reaches))

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

    def surrounds(self, bins: Bins) -> Mask:
        """Tell the absolute range and Doppler bins that lie in the map with all four neighbours."""
        (rows, columns), (n_rows, n_columns) = self.index(bins), self.gate.shape
        return (rows >= 1) & (rows < n_rows - 1) & (columns >= 1) & (columns < n_columns - 1)

    def index(self, bins: Bins) -> Bins:
        """Find range and Doppler bins in the map.

        Parameters
        ----------
        bins : (ndarray of int64, ndarray of int64)
            Absolute range and Doppler bins, shape (n,).

        Returns
        -------
        (ndarray of int64, ndarray of int64)
            Indices into `cells`.
        """
        return bins[0] - self.gate.range_bins[0], bins[1] - self.gate.doppler_bins[0]
