"""Iterative adaptive approach in every detected range-Doppler cell: a covariance made of the spectrum itself.

For every detected range-Doppler cell, on all P x Q elements and from the one
snapshot that there is:

1. Bartlett's spectrum over the directions that the region spans is a first
   model of the power from each of them.
2. The covariance of that model and of white noise gives a filter for each
   direction that suppresses all others. The power behind it is the next model.
   A few iterations sharpen the spectrum to a few peaks.
3. Power gathers on samples of the grid, so that peaks are biased towards them.
   Maximum likelihood on the whole snapshot moves the directions of a cell
   together from there, and drops those as weak as noise.

There is no smoothing, which would cost aperture, and no model order.

Cost of n cells, g x h directions whose steering vectors span s dimensions of
the array: n (2 s³ + s² (g + h)) an iteration, n (k P Q + k³) a step of the
likelihood for k sources.

Fails where sources are closer than a sample of the grid. A finer grid is worse
(docs/estimators.md): the power that it starts from grows with the number of
samples, and takes more iterations to come down.

References
----------
Yardibi, Li, Stoica, Xue and Baggeroer, "Source localization and sensing: a
nonparametric iterative adaptive approach based on weighted least squares",
IEEE Trans. AES 46 (2010).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from isacbench.checked_arrays import Floats
from isacbench.dsp.angles.beamformers import iaa_spectrum
from isacbench.dsp.angles.planar_spectra import AngularSpectrum
from isacbench.dsp.angles.plane_waves import PlaneWaves
from isacbench.dsp.fitting.maximum_likelihood import resolve_directions
from isacbench.errors import require_least
from isacbench.instrument.stages import stage

from .angular_spectra import AngularSpectrumEstimator
from .chain import CellSnapshots


@dataclass(frozen=True)
class Iaa2d(AngularSpectrumEstimator):
    """2D-FFT with OSCA-CFAR, then the iterative adaptive approach in every cell.

    Attributes
    ----------
    iterations : int
        Times that the power is estimated anew.
    polish : int
        Most steps of maximum likelihood; 0 leaves directions between the samples.
    samples_per_cell, angle_dynamic_range_db
        See `isacbench_algorithms.angular_spectra.AngularSpectrumEstimator`.
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

    name: ClassVar[str] = "iaa2d"

    angle_dynamic_range_db: float = 20.0
    samples_per_cell: int = 3
    iterations: int = 6
    polish: int = 3

    def __post_init__(self) -> None:
        super().__post_init__()
        require_least(self, iterations=1, polish=0)

    def placed(self, cells: CellSnapshots, waves: PlaneWaves) -> PlaneWaves:
        """Refine the directions of each cell by maximum likelihood, and drop those as weak as noise."""
        if not self.polish:
            return waves
        with stage("refinement"):
            floor = cells.levels.floor
            return resolve_directions(cells.own[:, None], waves, floor, self.angle_pfa, self.polish)

    def angular_spectrum(self, cells: CellSnapshots, u: Floats, w: Floats) -> AngularSpectrum:
        """Compute the spectrum of each cell by the iterative adaptive approach.

        Parameters
        ----------
        u, w : ndarray of float64, shapes (g,) and (h,)
            Direction cosines of the samples.
        """
        return iaa_spectrum(cells.own, cells.levels.floor, self.iterations, u, w)
