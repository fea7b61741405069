"""The baseline: four Fourier transforms, over subcarriers, symbols, rows and columns of the array.

The range-Doppler map comes with the observation. The P x Q snapshot of every
detected cell is zero-padded and transformed over both array axes. Local maxima
of the angular power spectrum inside the region's directions that pass a 2-D
CA-CFAR are plane waves; on arrays of so few elements that a lone wave would
fail that test, the highest alone. What the cells show is then explained
jointly (`isacbench_algorithms.chain`), exactly as for the other cell-by-cell
estimators.

With ``integration="element"`` one row and one column are transformed, each
along itself, and tested by a CA-CFAR along the line. The joint response of both
pairs the peaks of the one with those of the other.

Cost of n cells on a g x g angle grid: n g² log g for the transforms, n g log g
for those of a row and a column, then m (15 P Q + m) for m candidates.

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
from functools import cached_property
from typing import ClassVar, Literal, NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from isacbench.dsp.angles.aperture import Cross
from isacbench.dsp.angles.peaks import Peaks, plane_peaks
from isacbench.dsp.angles.plane_waves import PlaneWaves, pair_directions
from isacbench.dsp.cell_detection import detect_listed
from isacbench.dsp.cfar import Cells
from isacbench.errors import require
from isacbench.instrument.stages import stage
from isacbench.model.cloud import PointCloud
from isacbench.model.observation import Observation
from isacbench.model.region import Interval
from isacbench.plugins.contracts import Detector, Spectrum

from .chain import (
    CellPrecision,
    CellSnapshots,
    CellwiseEstimator,
    Snapshots,
    detect,
    explain,
    locate,
    read_cells,
    read_map,
)
from .detectors import CaCfar


class _CosineAxis(NamedTuple):
    """Cosines of a transform's samples, ascending, and which of them lie where the region is."""

    cosine: NDArray[np.float64]
    inside: NDArray[np.bool_]

    def at(self, sample: NDArray[np.float64]) -> NDArray[np.float64]:
        """Cosines between the samples."""
        cosine: NDArray[np.float64] = self.cosine[0] + 2 / self.cosine.size * sample
        return cosine


class _FourierSpectra(NamedTuple):
    """Power spectra (n, g) of lines of sensors, the cosines of their samples, and the peaks that pass."""

    cosine: NDArray[np.float64]
    power: NDArray[np.float64]
    peaks: Peaks


class _AngleSpectra(NamedTuple):
    """Angular power spectra (n, g, h), the cosines of their axes, and the peaks that pass their test."""

    u: NDArray[np.float64]
    w: NDArray[np.float64]
    power: NDArray[np.float64]
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
        Below the strongest source of a cell, what is taken for its sidelobes.
    detector, pfa, integration, range_window, doppler_window, max_sources, angle_pfa
        See `isacbench_algorithms.chain.CellwiseEstimator`.
    dynamic_range_db, local_dynamic_range_db, precision, explain, detection_window
        See `isacbench_algorithms.chain.CellwiseEstimator`.

    Raises
    ------
    InputError
        If a parameter is out of range.
    """

    name: ClassVar[str] = "fft4d"
    separable: ClassVar[bool] = True

    precision: CellPrecision = "single"
    angle_points: int = 48
    angle_detector: Detector = field(
        default_factory=lambda: CaCfar(pfa=1e-3, training=(0, 4, 4), guard=(0, 3, 3))
    )
    line_detector: Detector = field(default_factory=lambda: CaCfar(pfa=0.5, training=(0, 12), guard=(0, 3)))
    angle_dynamic_range_db: float = 12.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.angle_points >= 3, "angle_points", self.angle_points, "3 and more")
        limit_db = self.angle_dynamic_range_db
        require(limit_db > 0, "angle_dynamic_range_db", limit_db, "above 0")

    def estimate(self, observation: Observation) -> PointCloud:
        """Image one observation.

        Parameters
        ----------
        observation : Observation

        Returns
        -------
        PointCloud
        """
        rdm = read_map(observation, self)  # FFT over subcarriers and symbols
        detected = detect(rdm, self)  # OSCA-CFAR
        cells = read_cells(rdm, detected, self.readings()[0])  # P x Q snapshots
        if not len(cells):
            return PointCloud.empty()
        waves = self.plane_waves(observation, cells)  # FFT over rows and columns, CA-CFAR
        located = locate(cells, waves, self)  # range and velocity
        candidates = self.merge(self.own_cell_test(located))
        found = explain(rdm, detected.levels, [candidates], self)  # joint selection and refinement
        return self.to_cloud(rdm, found)

    def plane_waves(self, observation: Observation, cells: CellSnapshots) -> PlaneWaves:
        """Find local maxima of the angular power spectra inside the directions of the region.

        Parameters
        ----------
        observation : Observation
        cells : CellSnapshots

        Returns
        -------
        PlaneWaves
            One row a cell.
        """
        with stage("peaks"):
            aperture = self.aperture(observation)
            if not isinstance(aperture, Cross):
                return self._angle_spectra(observation, cells.own).waves
            along_u, along_w = self._line_spectra(observation, aperture, cells.own)
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
        """Cuts along u and along w through the maximum of the first cell's angular spectrum, in dB below it.

        Of a row and a column, the spectrum of each.
        """
        aperture = self.aperture(observation)
        if isinstance(aperture, Cross):
            along_u, along_w = self._line_spectra(observation, aperture, cells.own)
            return self._as_spectrum(along_u, "u"), self._as_spectrum(along_w, "w")
        found = self._angle_spectra(observation, cells.own)
        row, column = np.unravel_index(found.power[0].argmax(), found.power.shape[1:])
        strongest = found.power[0].max()
        level_db = _level_db(found.power[0], strongest)
        threshold_db = _level_db(self.angle_detector.detect(found.power).threshold[0], strongest)
        peaks = found.waves.found[0]
        return (
            Spectrum(found.u, level_db[:, column], threshold_db[:, column], found.waves.u[0][peaks], "u"),
            Spectrum(found.w, level_db[row], threshold_db[row], found.waves.w[0][peaks], "w"),
        )

    def _angle_spectra(self, observation: Observation, snapshots: Snapshots) -> _AngleSpectra:
        u, w = (
            self._axis(n, limits)
            for n, limits in zip(snapshots.shape[1:], observation.cosine_limits, strict=True)
        )
        shape = u.cosine.size, w.cosine.size
        with stage("spectrum"):
            spectra = scipy.fft.fftshift(scipy.fft.ifft2(snapshots, shape, norm="forward"), axes=(1, 2))
            power = spectra.real**2 + spectra.imag**2
        # Only local maxima can be peaks, so that nothing else needs a test.
        peaks = _spectral_maxima(power, self._strong(power, u.inside[:, None] & w.inside))
        passed = _passed(power, peaks, detect_listed(self.angle_detector, power, 1, peaks).mask)
        if not self._passes_a_lone_wave(snapshots.shape[1:], shape):
            passed[_strongest(power, peaks)] = True
        row, column, found = plane_peaks(power, passed, self.max_sources)
        return _AngleSpectra(u.cosine, w.cosine, power, PlaneWaves(u.at(row), w.at(column), found))

    def _passes_a_lone_wave(self, elements: tuple[int, ...], samples: tuple[int, int]) -> bool:
        """Whether the maximum of a lone plane wave without noise passes the test on P x Q elements.

        The mainlobe of a few elements covers whatever samples the detector
        compares with: of those it tells nothing.
        """
        key = elements, samples
        if key not in self._lone_waves:
            spectrum = scipy.fft.fftshift(scipy.fft.ifft2(np.ones(elements), samples, norm="forward"))
            power = (spectrum.real**2 + spectrum.imag**2)[None]
            peak = tuple(index[:1] for index in np.nonzero(power == power.max()))
            self._lone_waves[key] = bool(detect_listed(self.angle_detector, power, 1, peak).mask[0])
        return self._lone_waves[key]

    @cached_property
    def _lone_waves(self) -> dict[tuple[tuple[int, ...], tuple[int, int]], bool]:
        """Answers of `_passes_a_lone_wave`, by elements and samples."""
        return {}

    def _line_spectra(
        self, observation: Observation, aperture: Cross, snapshots: Snapshots
    ) -> tuple[_FourierSpectra, _FourierSpectra]:
        along_u, along_w = (lines[:, :, 0] for lines in aperture.lines(snapshots))
        u_limits, w_limits = observation.cosine_limits
        return self._line_spectrum(along_u, u_limits), self._line_spectrum(along_w, w_limits)

    def _line_spectrum(self, lines: Snapshots, limits: Interval) -> _FourierSpectra:
        """Spectra along the sensors of lines (n, sensors)."""
        axis = self._axis(lines.shape[1], limits)
        with stage("spectrum"):
            spectra = scipy.fft.fftshift(scipy.fft.ifft(lines, axis.cosine.size, norm="forward"), axes=1)
            # A plane of one column, for which peaks are the same thing.
            power = (spectra.real**2 + spectra.imag**2)[:, :, None]
        peaks = _spectral_maxima(power, self._strong(power, axis.inside[:, None]))
        passed = _passed(power, peaks, detect_listed(self.line_detector, power[:, :, 0], 1, peaks[:2]).mask)
        place, _, found = plane_peaks(power, passed, self.max_sources)
        return _FourierSpectra(axis.cosine, power[:, :, 0], Peaks(axis.at(place), found))

    def _axis(self, n_sensors: int, limits: Interval) -> _CosineAxis:
        n_points = max(self.angle_points, 2 * n_sensors)
        cosine = 2 * scipy.fft.fftshift(scipy.fft.fftfreq(n_points))
        lower, upper = limits
        return _CosineAxis(cosine, (cosine >= lower - 2 / n_points) & (cosine <= upper + 2 / n_points))

    def _strong(self, power: NDArray[np.float64], inside: NDArray[np.bool_]) -> Cells:
        """Samples of spectra (n, g, h) that are no sidelobes, as `numpy.nonzero` gives them."""
        strongest = power.max(axis=(1, 2), keepdims=True, initial=0)
        strong: Cells = np.nonzero((power > strongest * 10 ** (-self.angle_dynamic_range_db / 10)) & inside)
        return strong

    def _as_spectrum(self, line: _FourierSpectra, label: Literal["u", "w"]) -> Spectrum:
        """First of the spectra in dB below its maximum."""
        strongest = line.power[0].max()
        threshold = self.line_detector.detect(line.power).threshold[0]
        return Spectrum(
            line.cosine,
            _level_db(line.power[0], strongest),
            _level_db(threshold, strongest),
            line.peaks.place[0][line.peaks.found[0]],
            label,
        )


def _level_db(power: NDArray[np.float64], strongest: float) -> NDArray[np.float64]:
    """Level below the strongest in dB; of nulls, which may be exact, as low as rounding leaves them."""
    level_db: NDArray[np.float64] = 10 * np.log10(
        np.maximum(power / strongest, np.finfo(np.float64).eps ** 2)
    )
    return level_db


def _strongest(power: NDArray[np.float64], cells: Cells) -> Cells:
    """Of the listed cells (spectrum, row, column) the strongest of each spectrum."""
    order = np.lexsort((-power[cells], cells[0]))
    _, first = np.unique(cells[0][order], return_index=True)
    spectrum, row, column = (index[order[first]] for index in cells)
    return spectrum, row, column


def _passed(power: NDArray[np.float64], cells: Cells, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Samples of spectra that passed their test, out of listed ones."""
    passed = np.zeros(power.shape, dtype=np.bool_)
    passed[cells] = mask
    return passed


def _spectral_maxima(power: NDArray[np.float64], cells: Cells) -> Cells:
    """Those of the listed cells of periodic spectra (n, g, h) that no neighbour exceeds."""
    spectrum, row, column = cells
    n_rows, n_columns = power.shape[1:]
    neighbours = [
        power[spectrum, (row + down) % n_rows, (column + right) % n_columns]
        for down in (-1, 0, 1)
        for right in (-1, 0, 1)
    ]
    highest = power[cells] >= np.max(neighbours, axis=0)
    return spectrum[highest], row[highest], column[highest]
