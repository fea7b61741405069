"""Detection of the range-Doppler cells that hold echoes, on one element or on all, above a floor.

A CFAR detector distinguishes an echo from noise, but not from the leakage of a
strong echo into other cells: window sidelobes, and the misfit of any model to a
crowd of scatterers. Both scale with the strong echo. Without a limit on the
dynamic range, images would get worse as the SNR rises. The floor is therefore the
noise or this limit, whichever is higher.
"""

from __future__ import annotations

import inspect
from dataclasses import dataclass, replace
from functools import cached_property
from math import prod
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from isacbench.display import brief
from isacbench.dsp.array_types import Complex, Floats
from isacbench.dsp.detection import Detection, Detector
from isacbench.dsp.rangedoppler import Bins, GatedMap
from isacbench.model.gate import Gate

Integration = Literal["element", "noncoherent"]

PEAK_CELLS = 20
"""Number of cells whose mean power counts as the strongest echo: one cell may hold two echoes in phase."""

CLEAR_BINS = 3
"""Bins left out between those that echoes of the region can reach and those where noise is measured."""


@dataclass(frozen=True, eq=False)
class DetectedCells:
    """Cells that hold an echo.

    Attributes
    ----------
    power : ndarray of float64, shape (n_range, n_doppler)
        The map that was tested.
    detector : Detector
        The detector.
    looks : int
        Independent noise powers that each cell of the map averages.
    bins : (ndarray of int64, ndarray of int64), each shape (n,)
        Absolute range and Doppler bins of the cells kept: detected,
        reachable, and above the floor.
    gate : Gate
        Bins of the map.
    floor : float
        Power below which echoes cannot be distinguished from noise or from the
        leakage of the strongest ones.
    """

    power: Floats
    detector: Detector
    looks: int
    bins: Bins
    gate: Gate
    floor: float

    __repr__ = brief

    @cached_property
    def detection(self) -> Detection:
        """Test of the whole map, made when first asked for."""
        return self.detector.detect(self.power, self.looks)

    def strongest(self) -> DetectedCells:
        """Keep only the strongest of the cells; none if there is none."""
        rows, columns = self.bins[0] - self.gate.range_bins[0], self.bins[1] - self.gate.doppler_bins[0]
        first = np.argsort(-self.power[rows, columns], kind="stable")[:1]
        return replace(self, bins=(self.bins[0][first], self.bins[1][first]))


def power_map(cells: Complex, integration: Integration) -> tuple[Floats, int]:
    """Power of range-Doppler cells and the number of looks it averages.

    Parameters
    ----------
    cells : ndarray of complex, shape (n_range, n_doppler, *elements)
        Cells of any elements of the array, element (0, 0) first.
    integration : {"element", "noncoherent"}
        Power of the first element, or the average over all elements.

    Returns
    -------
    power : ndarray of float64, shape (n_range, n_doppler)
    looks : int
        Number of independent noise powers averaged.
    """
    n_looks = prod(cells.shape[2:])
    elements = np.ascontiguousarray(cells).reshape(*cells.shape[:2], n_looks)
    if integration == "element":
        element = elements[:, :, 0]
        return element.real**2 + element.imag**2, 1
    parts = elements.view(cells.real.dtype)
    return np.einsum("rde,rde->rd", parts, parts) / n_looks, n_looks


def reference_noise(power: Floats, gate: Gate, sees_lobes: bool = False) -> float | None:
    """Measure the noise power in Doppler bins, or range bins, that no echo of the region reaches.

    Parameters
    ----------
    power : ndarray of float64, shape (n_range, n_doppler)
    gate : Gate
        Bins of the map.
    sees_lobes : bool, default False
        True if every echo shows in grating lobes along all Doppler bins: noise
        is then measured in range bins.

    Returns
    -------
    float or None
        Median over those bins of their mean along the other axis, so that a
        mover beyond the region's speeds does not count as noise; None if the
        gate has no such bins.
    """
    axis = 0 if sees_lobes else 1
    reach = gate.reachable_range if sees_lobes else gate.reachable_doppler
    outside = np.r_[0 : max(reach.start - CLEAR_BINS, 0), reach.stop + CLEAR_BINS : power.shape[axis]]
    clear = power[outside] if sees_lobes else power[:, outside]
    return float(np.median(clear.mean(axis=1 - axis))) if outside.size else None


def white_noise(gated: GatedMap) -> float:
    """Measure the noise power of an untapered map, per cell and element.

    Parameters
    ----------
    gated : GatedMap

    Returns
    -------
    float
        Measured in the bins of `reference_noise`, after a Hann window along
        Doppler, which keeps the sidelobes of strong echoes out of them. Without
        such bins, the median power of the map.
    """
    seen = gated.tapered("hann" if gated.sees_lobes else "rect", gated.doppler_taper("hann"))
    power = power_map(seen.cells, "noncoherent")[0]
    noise = reference_noise(power, seen.gate, seen.sees_lobes)
    return float(np.median(power)) if noise is None else noise


def detect_listed(
    detector: Detector, power: Floats, looks: int, cells: tuple[NDArray[np.intp], ...]
) -> Detection:
    """Test listed cells of a power map, and only those if the detector takes a list.

    Parameters
    ----------
    detector : Detector
        If its `detect` does not take ``cells``, all cells are tested and the
        listed ones picked.
    power : ndarray of float64
        Power map of any rank.
    looks : int
        Independent noise powers that each cell averages.
    cells : tuple of ndarray of int, each shape (n,)
        Cells to test, as `numpy.nonzero` gives them.

    Returns
    -------
    Detection
        Arrays of shape (n,).
    """
    if "cells" in inspect.signature(detector.detect).parameters:
        return cast("Detection", cast("Any", detector).detect(power, looks, cells=cells))
    whole = detector.detect(power, looks)
    return Detection(whole.mask[cells], whole.threshold[cells], whole.noise[cells])


def detect_cells(
    gated: GatedMap, detector: Detector, integration: Integration, dynamic_range_db: float
) -> DetectedCells:
    """Detect cells of a gated range-Doppler map.

    Parameters
    ----------
    gated : GatedMap
    detector : Detector
    integration : {"element", "noncoherent"}
    dynamic_range_db : float
        Range below the strongest cells in which echoes can be distinguished
        from their leakage.

    Returns
    -------
    DetectedCells
    """
    gate = gated.gate
    power, looks = power_map(gated.cells, integration)
    noise = reference_noise(power, gate, gated.sees_lobes)
    if noise is None:
        noise = float(np.median(detector.detect(power, looks).noise))
    strongest = np.sort(power[gate.reachable])[-PEAK_CELLS:].mean()
    floor = max(noise, float(strongest) * 10 ** (-dynamic_range_db / 10))
    rows, columns = candidates = np.nonzero(gate.reachable & (power > floor))
    found = detect_listed(detector, power, looks, candidates).mask
    bins = gate.range_bins[rows[found]], gate.doppler_bins[columns[found]]
    return DetectedCells(power, detector, looks, bins, gate, floor)
