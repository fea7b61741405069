"""The baseline: four Fourier transforms, over subcarriers, symbols, rows and columns of the array.

The range-Doppler map comes with the observation. The P x Q snapshot of every
detected cell is zero-padded and transformed over both array axes. Local maxima
of the angular power spectrum inside the region's directions that pass a 2-D
CA-CFAR are plane waves; on arrays of so few elements that a lone wave might
fail that test, the highest is one in any case.

With ``integration="element"`` one row and one column are transformed, each
along itself, and tested by a CA-CFAR along the line. The joint response of both
pairs the peaks of the one with those of the other.

Cost of n cells on a g x g angle grid: n g² log g for the transforms, n g log g
for those of a row and a column.

Fails where sources of one cell are closer than a Rayleigh cell (2/P in u,
2/Q in w): they have one maximum. Sources more than 12 dB below another in
their cell are taken for its sidelobes, which lie at -13 dB. A row and a column
cannot say which of their peaks belong together where these are equal in
amplitude and phase.

References
----------
arXiv 2310.06401, the 4D-FFT that it compares with.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import prod
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from isacbench.checked_arrays import Complex, Floats, Mask, parts_of
from isacbench.dsp.angles.aperture import Cross
from isacbench.dsp.angles.peaks import Peaks, Places, plane_maxima, plane_peaks
from isacbench.dsp.angles.plane_waves import PlaneWaves, pair_directions
from isacbench.dsp.cell_detection import Integration
from isacbench.dsp.detection import detect_listed
from isacbench.dsp.rangedoppler import CACHED_SAMPLES
from isacbench.errors import require_least, require_positive
from isacbench.instrument.stages import stage
from isacbench.model.kernels import PERIOD, within_period
from isacbench.model.observation import Observation
from isacbench.model.region import Interval
from isacbench.plugins.contracts import Detector, Spectrum

from .angular_spectra import spectrum_cut
from .chain import CellPrecision, CellSnapshots, CellwiseEstimator
from .detectors import CaCfar, OscaCfar

CLEARLY = 2.0
"""Ratio of a lone wave's maximum to its threshold; places take up to 28 % off it, and noise some more."""


class _LineSpectra(NamedTuple):
    """Power spectra (n, g) of lines of sensors, the cosines of their samples, and the peaks that pass."""

    cosine: Floats
    power: Floats
    peaks: Peaks


class _AngleSpectra(NamedTuple):
    """Angular power spectra (n, g, h), the cosines of their axes, and the peaks that pass their test."""

    u: Floats
    w: Floats
    power: Floats
    waves: PlaneWaves


@dataclass(frozen=True)
class Fft4d(CellwiseEstimator):
    """4D-FFT: range-Doppler detection, then a zero-padded 2-D FFT over the array with a 2-D CA-CFAR.

    Attributes
    ----------
    angle_points : int
        Samples of the angular spectrum along u, and along w; at least twice
        the elements are taken.
    angle_detector : Detector
        Of peaks in a stack of angular spectra (cells, u, w).
    line_detector : Detector
        Of peaks in a stack of spectra of one line of sensors (cells, cosine),
        with `integration` "element". The default passes a peak 10 dB below
        another that its training cells hold.
    angle_dynamic_range_db : float
        Range below the strongest source of a cell; weaker maxima count as its sidelobes.
    detector, pfa, integration, range_window, doppler_window, max_sources, angle_pfa
        See `isacbench_algorithms.chain.CellwiseEstimator`.
    dynamic_range_db, local_dynamic_range_db, precision, detection_window, largest_direction_error,
    range_excess, doppler_excess
        See `isacbench_algorithms.chain.CellwiseEstimator`.

    Raises
    ------
    InputError
        If a parameter is out of range.
    """

    name: ClassVar[str] = "fft4d"
    separable: ClassVar[bool] = True

    detector: Detector = field(default_factory=lambda: OscaCfar(order_axis=1))
    integration: Integration = "noncoherent"
    dynamic_range_db: float = 33.0
    largest_direction_error: float | None = None
    precision: CellPrecision = "single"
    angle_points: int = 48
    angle_detector: Detector = field(
        default_factory=lambda: CaCfar(pfa=1e-3, training=(0, 4, 4), guard=(0, 3, 3))
    )
    line_detector: Detector = field(default_factory=lambda: CaCfar(pfa=0.5, training=(0, 12), guard=(0, 3)))
    angle_dynamic_range_db: float = 12.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_least(self, angle_points=3)
        require_positive(self, "angle_dynamic_range_db")

    def plane_waves(self, observation: Observation, cells: CellSnapshots) -> PlaneWaves:
        """Find local maxima of the angular power spectra inside the directions of the region.

        Returns
        -------
        PlaneWaves
            One row a cell.
        """
        with stage("peaks"):
            aperture = self.aperture(observation)
            if not isinstance(aperture, Cross):
                return self._angle_spectra(observation, cells.own).waves
            along_u, along_w = map(self._line_spectrum, aperture.lines(cells.own), observation.cosine_limits)
            return pair_directions(
                cells.own,
                aperture,
                along_u.peaks,
                along_w.peaks,
                cells.levels.min_power,
                self.angle_dynamic_range_db,
                self.max_sources,
            )

    def spectra(self, observation: Observation, cells: CellSnapshots) -> tuple[Spectrum, ...]:
        """Cut the first cell's angular spectrum through its maximum along u and along w, in dB below it.

        Of a row and a column, the spectrum of each.
        """
        aperture = self.aperture(observation)
        if isinstance(aperture, Cross):
            along_u, along_w = map(self._line_spectrum, aperture.lines(cells.own), observation.cosine_limits)
            return self._line_cut(along_u, "u"), self._line_cut(along_w, "w")
        found = self._angle_spectra(observation, cells.own)
        row, column = np.unravel_index(found.power[0].argmax(), found.power.shape[1:])
        power, threshold = found.power[0], self.angle_detector.detect(found.power).threshold[0]
        u, w = (places[0][found.waves.found[0]] for places in (found.waves.u, found.waves.w))
        return (
            spectrum_cut(found.u, power[:, column], threshold[:, column], u, "u"),
            spectrum_cut(found.w, power[row], threshold[row], w, "w"),
        )

    def _angle_spectra(self, observation: Observation, snapshots: Complex) -> _AngleSpectra:
        u, u_inside = self._cosines(snapshots.shape[1], observation.cosine_limits[0])
        w, w_inside = self._cosines(snapshots.shape[2], observation.cosine_limits[1])
        with stage("spectrum"):
            power = _fourier_power(snapshots, (u.size, w.size))
        spectrum, *_ = maxima = self._strong_maxima(power, u_inside[:, None] & w_inside)
        passed = detect_listed(self.angle_detector, power, 1, maxima).mask
        if not self._clearly_passes_a_lone_wave(snapshots.shape[1:], (u.size, w.size)):
            highest = np.lexsort([-power[maxima], spectrum])
            passed[highest[np.unique(spectrum, return_index=True)[1]]] = True
        row, column, found = plane_peaks(power, tuple(index[passed] for index in maxima), self.max_sources)
        return _AngleSpectra(u, w, power, PlaneWaves(_between(u, row), _between(w, column), found))

    def _clearly_passes_a_lone_wave(self, elements: tuple[int, ...], samples: tuple[int, int]) -> bool:
        """Test the maximum of a lone plane wave without noise on P x Q elements.

        The mainlobe of a few elements covers all samples that the detector
        compares with: then its test tells nothing. `CLEARLY` leaves room for waves
        between samples, and near the end of an axis, where windows are shifted.
        """
        power = _fourier_power(np.ones((1, *elements)), samples)
        peak = tuple(index[:1] for index in np.nonzero(power == power.max()))
        return bool(power.max() > CLEARLY * detect_listed(self.angle_detector, power, 1, peak).threshold[0])

    def _line_spectrum(self, lines: Complex, limits: Interval) -> _LineSpectra:
        """Spectra along the sensors of lines (n, sensors, 1), as planes of one column."""
        cosine, inside = self._cosines(lines.shape[1], limits)
        with stage("spectrum"):
            power = _fourier_power(lines, (cosine.size, 1))
        maxima = self._strong_maxima(power, inside[:, None])
        passed = detect_listed(self.line_detector, power[:, :, 0], 1, maxima[:2]).mask
        sample, _, found = plane_peaks(power, tuple(index[passed] for index in maxima), self.max_sources)
        return _LineSpectra(cosine, power[:, :, 0], Peaks(_between(cosine, sample), found))

    def _cosines(self, n_sensors: int, limits: Interval) -> tuple[Floats, Mask]:
        """Cosines of a transform's samples, ascending, and the mask of those in the region."""
        n_points = max(self.angle_points, 2 * n_sensors)
        cosine = 2 * np.fft.fftshift(np.fft.fftfreq(n_points))
        # One sample beyond the limits, on the circle of cosines.
        inside = (cosine - limits[0] + 2 / n_points) % PERIOD <= limits[1] - limits[0] + 4 / n_points
        return cosine, inside

    def _strong_maxima(self, power: Floats, inside: Mask) -> Places:
        """Local maxima of spectra (n, g, h) inside the region that are no sidelobes."""
        strongest = power.max(axis=(1, 2), keepdims=True, initial=0)
        strong = power > strongest * 10 ** (-self.angle_dynamic_range_db / 10)
        return plane_maxima(power, strong & inside)

    def _line_cut(self, line: _LineSpectra, label: Literal["u", "w"]) -> Spectrum:
        threshold = self.line_detector.detect(line.power).threshold[0]
        places = line.peaks.place[0][line.peaks.found[0]]
        return spectrum_cut(line.cosine, line.power[0], threshold, places, label)


def _fourier_power(snapshots: NDArray[np.inexact], samples: tuple[int, int]) -> Floats:
    """Angular power spectra (n, *samples) of snapshots (n, P, Q), cosines ascending.

    The transforms are products with matrices: for so few elements an FFT takes longer, and shifts its result.
    """
    along_u, along_w = (
        np.exp(2j * np.pi / n * np.outer(np.arange(n) - n // 2, np.arange(n_elements)))
        for n, n_elements in zip(samples, snapshots.shape[1:], strict=True)
    )
    power = np.empty((len(snapshots), *samples))
    for some in parts_of(len(snapshots), CACHED_SAMPLES // prod(samples)):
        spectra = along_u @ (snapshots[some] @ along_w.T)
        power[some] = spectra.real**2 + spectra.imag**2
    return power


def _between(cosine: Floats, sample: Floats) -> Floats:
    """Cosines at fractional samples."""
    return within_period(cosine[0] + PERIOD / cosine.size * sample)
