"""Base of the estimators that find the plane waves of a cell as peaks of an angular power spectrum."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from isacbench.checked_arrays import Floats
from isacbench.dsp.angles.peaks import direction_samples
from isacbench.dsp.angles.planar_spectra import AngularSpectrum
from isacbench.dsp.angles.plane_waves import PlaneWaves
from isacbench.errors import require_least, require_positive
from isacbench.instrument.stages import stage
from isacbench.model.kernels import within_period
from isacbench.model.observation import Observation
from isacbench.plugins.contracts import Spectrum

from .chain import CellSnapshots, CellwiseEstimator

SAME_CELLS = 0.05
"""Rayleigh cells within which two peaks are one: equal samples next to each other lead to one peak."""


@dataclass(frozen=True)
class AngularSpectrumEstimator(CellwiseEstimator):
    """Parameters and stages that spectral methods share; subclasses compute the spectrum.

    Attributes
    ----------
    samples_per_cell : int
        Samples of the spectrum a Rayleigh cell of the array, 2/P in u and 2/Q in w.
    angle_dynamic_range_db : float
        Range below the strongest peak of a cell; weaker peaks count as its sidelobes.
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

    dynamic_range_db: float = 33.0
    samples_per_cell: int = 4
    angle_dynamic_range_db: float = 12.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_least(self, samples_per_cell=2)
        require_positive(self, "angle_dynamic_range_db")

    def plane_waves(self, observation: Observation, cells: CellSnapshots) -> PlaneWaves:
        """Find the peaks of the angular spectra.

        Returns
        -------
        PlaneWaves
            One row a cell.
        """
        with stage("spectrum"):
            spectrum = self.angular_spectrum(cells, *self.grid(observation))
        with stage("peaks"):
            waves = spectrum.waves(self.angle_dynamic_range_db, self.max_sources)
        waves = self.placed(cells, waves)
        with stage("peaks"):
            return self.above_noise(observation, cells, waves)

    def placed(self, cells: CellSnapshots, waves: PlaneWaves) -> PlaneWaves:
        """Place the peaks of a spectrum better; by default they stay."""
        return waves

    def above_noise(self, observation: Observation, cells: CellSnapshots, waves: PlaneWaves) -> PlaneWaves:
        """Keep the plane waves that exceed the noise of their cell, each direction once."""
        apart = np.hypot(
            *(
                n / 2 * within_period(line[:, :, None] - line[:, None])
                for n, line in zip(observation.array.shape, (waves.u, waves.w), strict=True)
            )
        )
        before = np.tril(waves.found[:, None] & (apart < SAME_CELLS), -1)
        waves = replace(waves, found=waves.found & ~before.any(axis=2))
        power = np.abs(waves.amplitudes(cells.own[None], self.aperture(observation))[0]) ** 2
        return replace(waves, found=waves.found & (power > cells.levels.min_power))

    @abstractmethod
    def angular_spectrum(self, cells: CellSnapshots, u: Floats, w: Floats) -> AngularSpectrum:
        """Compute the angular power spectrum of each cell.

        Parameters
        ----------
        u, w : ndarray of float64, shapes (g,) and (h,)
            Direction cosines of the samples.
        """

    def grid(self, observation: Observation) -> tuple[Floats, Floats]:
        """Sample the directions that the region spans, and one sample beyond to either side.

        Returns
        -------
        u, w : ndarray of float64, shapes (g,) and (h,)
        """
        widest = [2 / (n * self.samples_per_cell) for n in observation.array.shape]
        return direction_samples(observation.cosine_limits, widest)

    def spectra(self, observation: Observation, cells: CellSnapshots) -> tuple[Spectrum, ...]:
        """Cut the first cell's spectrum through its maximum along u and along w, in dB below it."""
        found = self.angular_spectrum(cells, *self.grid(observation))
        waves = self.plane_waves(observation, cells)
        power = found.power[0]
        row, column = np.unravel_index(power.argmax(), power.shape)
        u, w = (places[0][waves.found[0]] for places in (waves.u, waves.w))
        return (
            spectrum_cut(found.u, power[:, column], None, u, "u"),
            spectrum_cut(found.w, power[row], None, w, "w"),
        )


def spectrum_cut(
    cosine: Floats, power: Floats, threshold: Floats | None, places: Floats, label: Literal["u", "w"]
) -> Spectrum:
    """Draw a line through the maximum of a spectrum, in dB below it.

    Parameters
    ----------
    cosine, power : ndarray of float64, shape (g,)
        Exact nulls are shown as low as rounding.
    threshold : ndarray of float64, shape (g,), or None
        Power that a peak has to exceed.
    places : ndarray of float64, shape (k,)
        Direction cosines that are taken for echoes.
    label : {"u", "w"}
    """

    def below_db(level: Floats) -> Floats:
        lowest: Floats = np.maximum(level / power.max(), np.finfo(np.float64).eps ** 2)
        return 10 * np.log10(lowest)

    threshold_db = None if threshold is None else below_db(threshold)
    return Spectrum(cosine, below_db(power), threshold_db, places, label)
