"""The baseline: four Fourier transforms, over subcarriers, symbols, rows and columns of the array.

The range-Doppler map comes with the observation. The P x Q snapshot of every
detected cell is zero-padded and transformed over both array axes. Local maxima
of the angular power spectrum inside the region's directions that pass a 2-D
CA-CFAR are plane waves. What the cells show is then explained
jointly (`isacbench_algorithms.cellwise`), exactly as for the other cell-by-cell
estimators.

Cost of n cells on a g x g angle grid: n g² log g for the transforms, then
m (15 P Q + m) for m candidates.

Fails where sources of one cell are closer than a Rayleigh cell (2/P in u,
2/Q in w): they have one maximum. Sources more than 12 dB below another in
their cell are taken for its sidelobes, which lie at -13 dB.

References
----------
arXiv 2310.06401, the 4D-FFT that it compares with.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from isacbench.contracts import Detector, Spectrum
from isacbench.dsp.cfar import Cells
from isacbench.dsp.detection import detect_listed
from isacbench.dsp.peaks import plane_peaks
from isacbench.dsp.planewaves import PlaneWaves
from isacbench.errors import require
from isacbench.model.observation import Observation
from isacbench.stages import stage

from .cellwise import CellwiseEstimator, Levels, Look, Snapshots, middle
from .detectors import CaCfar

__all__ = ["Fft4d"]


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
    angle_dynamic_range_db : float
        Below the strongest source of a cell, what is taken for its sidelobes.
    detector, pfa, integration, range_window, doppler_window, max_sources, angle_pfa
        See `isacbench_algorithms.cellwise.CellwiseEstimator`.
    dynamic_range_db, local_dynamic_range_db : float
        See `isacbench_algorithms.cellwise.CellwiseEstimator`.

    Raises
    ------
    InputError
        If a parameter is out of range.
    """

    name: ClassVar[str] = "fft4d"

    angle_points: int = 48
    angle_detector: Detector = field(
        default_factory=lambda: CaCfar(pfa=1e-3, training=(0, 4, 4), guard=(0, 3, 3))
    )
    angle_dynamic_range_db: float = 12.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.angle_points >= 3, "angle_points", self.angle_points, "3 and more")
        limit_db = self.angle_dynamic_range_db
        require(limit_db > 0, "angle_dynamic_range_db", limit_db, "above 0")

    def plane_waves(
        self,
        observation: Observation,
        look: Look,
        snapshots: Snapshots,
        levels: Levels,
        min_power: float,
    ) -> PlaneWaves:
        """Local maxima of the angular power spectra inside the directions of the region."""
        return self._angle_spectra(observation, middle(snapshots)).waves

    def spectra(self, observation: Observation, snapshots: Snapshots, levels: Levels) -> tuple[Spectrum, ...]:
        """Cuts along u and along w through the maximum of one cell's angular spectrum, in dB below it."""
        found = self._angle_spectra(observation, middle(snapshots))
        row, column = np.unravel_index(found.power[0].argmax(), found.power.shape[1:])
        strongest = found.power[0].max()
        level_db = 10 * np.log10(found.power[0] / strongest)
        threshold_db = 10 * np.log10(self.angle_detector.detect(found.power).threshold[0] / strongest)
        peaks = found.waves.found[0]
        return (
            Spectrum(found.u, level_db[:, column], threshold_db[:, column], found.waves.u[0][peaks], "u"),
            Spectrum(found.w, level_db[row], threshold_db[row], found.waves.w[0][peaks], "w"),
        )

    def _angle_spectra(self, observation: Observation, snapshots: Snapshots) -> _AngleSpectra:
        shape = tuple(max(self.angle_points, 2 * n) for n in snapshots.shape[1:])
        cosines = [2 * scipy.fft.fftshift(scipy.fft.fftfreq(n)) for n in shape]
        with stage("spectrum"):
            spectra = scipy.fft.fftshift(scipy.fft.ifft2(snapshots, shape, norm="forward"), axes=(1, 2))
            power = spectra.real**2 + spectra.imag**2
        strongest = power.max(axis=(1, 2), keepdims=True, initial=0)
        in_u, in_w = (
            (cosine >= lower - 2 / n) & (cosine <= upper + 2 / n)
            for cosine, (lower, upper), n in zip(cosines, observation.cosine_limits, shape, strict=True)
        )
        allowed = power > strongest * 10 ** (-self.angle_dynamic_range_db / 10)
        allowed &= in_u[:, None] & in_w
        # Only local maxima can be peaks, so that nothing else needs a test.
        peaks = _local_maxima(power, np.nonzero(allowed))
        allowed[:] = False
        allowed[peaks] = detect_listed(self.angle_detector, power, 1, peaks).mask
        row, column, found = plane_peaks(power, allowed, self.max_sources)
        u, w = (
            cosine[0] + 2 / n * place for cosine, n, place in zip(cosines, shape, (row, column), strict=True)
        )
        return _AngleSpectra(cosines[0], cosines[1], power, PlaneWaves(u, w, found))


def _local_maxima(power: NDArray[np.float64], cells: Cells) -> Cells:
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
