"""Detection of the range-Doppler cells that hold echoes, on beams, on one element, on all, or on m of n.

A CFAR detector distinguishes an echo from noise, but not from the leakage of a
strong echo into other cells: window sidelobes, and the misfit of any model to a
crowd of scatterers. Both scale with the strong echo. Without a limit on the
dynamic range, images would get worse as the SNR rises. The floor is therefore the
noise or this limit, whichever is higher.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import prod
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc

from isacbench.checked_arrays import Complex, Floats, Integers, Mask
from isacbench.display import short_repr
from isacbench.dsp.beam_integration import BeamDetection, BeamIntegration, Beams
from isacbench.dsp.detection import Detection, Detector, detect_listed
from isacbench.dsp.rangedoppler import WHOLE, GatedMap, TaperedMap
from isacbench.dsp.windows import Window
from isacbench.errors import require
from isacbench.model.gate import Bins, Gate
from isacbench.model.region import Interval

Integration = Literal["beams", "noncoherent", "element", "binary"]

PEAK_CELLS = 20
"""Number of cells whose mean power counts as the strongest echo: one cell may hold two echoes in phase."""

WHOLE_CIRCLE = (-1.0, 1.0), (-1.0, 1.0)
"""Limits of direction cosines u, and w, without a region."""

CLEAR_BINS = 3
"""Bins left out between those that echoes of the region can reach and those where noise is measured."""


class BeamsOfCells(NamedTuple):
    """Strongest beam of each of n detected cells.

    Attributes
    ----------
    u, w : ndarray of float64, shape (n,)
        Its direction cosines.
    alone : ndarray of bool, shape (n,)
        Mask of the cells that this beam alone shows: their mean power is that of noise.
    """

    u: Floats
    w: Floats
    alone: Mask

    def select(self, keep: Mask | Integers) -> BeamsOfCells:
        """Select cells by a mask or by indices."""
        return BeamsOfCells(self.u[keep], self.w[keep], self.alone[keep])


@dataclass(frozen=True, eq=False)
class DetectedCells:
    """Cells that hold an echo.

    Attributes
    ----------
    power : ndarray of float64, shape (n_range, n_doppler)
        Mean power of the elements, or power of one element.
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
    beams : BeamsOfCells or None
        Strongest beams of these cells, if they were detected on beams.
    """

    power: Floats
    detector: Detector
    looks: int
    bins: Bins
    gate: Gate
    floor: float
    beams: BeamsOfCells | None = None

    __repr__ = short_repr

    @cached_property
    def detection(self) -> Detection:
        """Test of the whole map, made when first asked for."""
        return self.detector.detect(self.power, self.looks)

    @property
    def tested_power(self) -> Floats:
        """Power map that `detection` compares with its thresholds."""
        return self.detection.power if isinstance(self.detection, BeamDetection) else self.power

    def strongest(self) -> DetectedCells:
        """Keep only the strongest of the cells; none if there is none."""
        first = np.argsort(-self.power[self.gate.index(self.bins)], kind="stable")[:1]
        beams = self.beams and self.beams.select(first)
        return replace(self, bins=(self.bins[0][first], self.bins[1][first]), beams=beams)


def power_map(cells: Complex, integration: Integration) -> tuple[Floats, int]:
    """Power of cells (n_range, n_doppler, *elements), and the number of looks it averages.

    With `integration` "element" that of the first element, (0, 0); else the average over all.
    """
    n_looks = prod(cells.shape[2:])
    elements = np.ascontiguousarray(cells).reshape(*cells.shape[:2], n_looks)
    if integration == "element":
        element = elements[:, :, 0]
        return element.real**2 + element.imag**2, 1
    parts = elements.view(cells.real.dtype)
    return np.einsum("rde,rde->rd", parts, parts) / n_looks, n_looks


def tapered_power(
    tapered: TaperedMap, integration: Integration, part: tuple[slice, slice] = WHOLE
) -> tuple[Floats, int]:
    """Power of the cells of a tapered map, or of a part of it, and the number of looks, as of `power_map`."""
    powers, looks = zip(*(power_map(cells, integration) for cells in tapered.blocks(part)), strict=True)
    return np.concatenate(powers), looks[0]


def reference_noise(power: Floats, gate: Gate, sees_lobes: bool = False) -> float | None:
    """Measure the noise power in Doppler bins, or range bins, that no echo of the region reaches.

    The median over those bins of their mean along the other axis, so that a mover beyond the region's speeds
    does not count as noise; None if the gate has no such bins. If `sees_lobes`, every echo shows in grating
    lobes along all Doppler bins: noise is then measured in range bins.
    """
    means = [power[side].mean(axis=1 if sees_lobes else 0) for side in _clear_sides(gate, sees_lobes)]
    return float(np.median(np.concatenate(means))) if means else None


def _clear_sides(gate: Gate, sees_lobes: bool) -> list[tuple[slice, slice]]:
    """Parts of the gate, on either side of the echoes, with the bins of `reference_noise`."""
    reachable = gate.reachable_range if sees_lobes else gate.reachable_doppler
    last = gate.shape[0 if sees_lobes else 1]
    sides = slice(0, reachable.start - CLEAR_BINS), slice(reachable.stop + CLEAR_BINS, last)
    clear = [side for side in sides if 0 < side.stop > side.start]
    return [(side, slice(None)) if sees_lobes else (slice(None), side) for side in clear]


def white_noise(gated: GatedMap) -> float:
    """Measure the noise power of an untapered map, per cell and element.

    In the bins of `reference_noise`, after a Hann window along Doppler, which keeps the sidelobes of strong
    echoes out of them. Without such bins, the median power of the map.
    """
    tapered = gated.tapered(*(("hann", "rect") if gated.sees_lobes else ("rect", "hann")))
    power = np.empty(tapered.gate.shape)
    for part in _clear_sides(tapered.gate, gated.sees_lobes) or [WHOLE]:
        power[part], _ = tapered_power(tapered, "noncoherent", part)
    noise = reference_noise(power, tapered.gate, gated.sees_lobes)
    return float(np.median(power)) if noise is None else noise


@dataclass(frozen=True)
class BinaryIntegration:
    """Detector of the cells in which at least m of n elements detect an echo, each in its own map.

    In white noise, the same of all elements but independent, and with p the
    detector's probability of false alarm, that of a cell is
    Σ C(n, k) pᵏ (1 - p)ⁿ⁻ᵏ over k from m to n. The union, m = 1, has
    1 - (1 - p)ⁿ: 0.23 for p = 1e-3 and 256 elements.

    Attributes
    ----------
    detector : Detector
        Of one element, with one look.
    powers : ndarray of float64, shape (n_range, n_doppler, n)
    m : int
        From 1 to n.

    Raises
    ------
    InputError
        If `m` is larger than n or below 1.

    References
    ----------
    M. Schwartz, "A coincidence procedure for signal detection", IRE Trans. IT 2
    (1956).
    """

    name: ClassVar[str] = "binary"

    detector: Detector
    powers: Floats
    m: int

    def __post_init__(self) -> None:
        n = self.powers.shape[-1]
        require(1 <= self.m <= n, "m_of_n", self.m, f"from 1 to the {n} elements")

    @property
    def pfa(self) -> float:
        """Probability of false alarm per cell in white noise."""
        n = self.powers.shape[-1]
        return float(betainc(self.m, n - self.m + 1, self.detector.pfa))  # the tail of the binomial law

    def detect(
        self,
        power: NDArray[np.floating[Any]],
        looks: int = 1,
        cells: tuple[NDArray[np.intp], ...] | None = None,
    ) -> Detection:
        """Test cells of all elements.

        Parameters
        ----------
        power : ndarray of float64, shape (n_range, n_doppler)
            Of no effect, as are `looks`.
        cells : tuple of ndarray of int, optional
            Cells to test, as `numpy.nonzero` gives them; default: all cells.

        Returns
        -------
        Detection
            Thresholds and noise are means over the elements.
        """
        one, n = self.detector, self.powers.shape[-1]
        sums = np.zeros((3, *(power.shape if cells is None else cells[0].shape)))
        for element in np.moveaxis(self.powers, -1, 0):
            found = one.detect(element) if cells is None else detect_listed(one, element, 1, cells)
            sums += [found.mask, found.threshold, found.noise]
        count, threshold, noise = sums
        return Detection(count >= self.m, threshold / n, noise / n)


def detect_cells(
    tapered: TaperedMap,
    detector: Detector,
    integration: Integration,
    dynamic_range_db: float,
    m_of_n: int = 1,
    cosine_limits: tuple[Interval, Interval] = WHOLE_CIRCLE,
) -> DetectedCells:
    """Detect cells of a tapered range-Doppler map.

    Echoes within `dynamic_range_db` of the strongest cells can be distinguished from their leakage. With
    `integration` "beams", the strongest beam within `cosine_limits` of u and w must lie above that leakage.
    With "binary", `m_of_n` elements must detect a cell, and one of them must lie above the floor.
    """
    gate = tapered.gate
    power, looks = tapered_power(tapered, integration)
    highest = power
    if integration == "binary":
        elements = tapered.cells.reshape(*power.shape, -1)
        powers = elements.real**2 + elements.imag**2
        detector, highest = BinaryIntegration(detector, powers, m_of_n), powers.max(axis=-1)
    noise = reference_noise(power, gate, tapered.sees_lobes)
    if noise is None:
        noise = float(np.median(detector.detect(power, looks).noise))
    strongest = np.sort(power[gate.reachable])[-PEAK_CELLS:].mean()
    leakage = float(strongest) * 10 ** (-dynamic_range_db / 10)
    least = floor = max(noise, leakage)
    if integration == "beams":
        detector, least = beam_integration(tapered, detector, noise, leakage, cosine_limits), leakage
    rows, columns = candidates = np.nonzero(gate.reachable & (highest > least))
    found = detect_listed(detector, power, looks, candidates)
    bins = gate.range_bins[rows[found.mask]], gate.doppler_bins[columns[found.mask]]
    beams = None
    if isinstance(detector, BeamIntegration) and isinstance(found, BeamDetection):
        directions = detector.beams.directions(found.beam[found.mask])
        beams = BeamsOfCells(*directions, found.alone[found.mask])
    return DetectedCells(power, detector, looks, bins, gate, floor, beams)


def beam_integration(
    tapered: TaperedMap,
    detector: Detector,
    noise: float,
    leakage: float,
    cosine_limits: tuple[Interval, Interval],
) -> BeamIntegration:
    """Detector on beams, for the noise of a map and the leakage of its strongest cells, per element.

    Where no beam shows this leakage, the taper is one that keeps more of an echo.
    """
    aperture, windows = tapered.aperture, tapered.windows
    if leakage * aperture.n_elements < noise:
        windows = _less_tapered(windows[0]), _less_tapered(windows[1])
    beams = Beams((aperture.n_p, aperture.n_q), cosine_limits)
    return BeamIntegration(detector, replace(tapered, windows=windows), beams, noise, leakage)


def _less_tapered(window: Window) -> Window:
    """Window of the same reach as Hann's that keeps 0.4 dB more; all others stay."""
    return "hamming" if window == "hann" else window
