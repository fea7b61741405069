"""Capon's beamformer (MVDR) with spatial smoothing and diagonal loading in every detected range-Doppler cell.

For every detected range-Doppler cell:

1. Forward-backward smoothing over all subarrays of the snapshot gives a real
   covariance R. Echoes of one cell are coherent: without smoothing they
   would cancel each other.
2. Power relative to the floor of noise and leakage is added to its diagonal, so
   that small errors of R do not cancel the source itself.
3. The power behind the filter that passes a direction and least of all else,
   1 / (a^H R^-1 a), is sampled over the directions that the region spans, and
   its maxima placed off the grid by Newton's method.

Cost of n cells on subarrays of L x M, S shifts of them and g x h directions:
n (S (L M)² + (L M)³) for the covariances and their inverses, n L² M h (M + g)
for the spectra.

Fails where sources are closer than about half the Rayleigh cell of a subarray,
more so in phase, which smoothing over few shifts hardly changes; and where the
loading, which follows the leakage of strong echoes, exceeds a weak source.

References
----------
Capon, "High-resolution frequency-wavenumber spectrum analysis", Proc. IEEE 57
(1969).
Shan, Wax and Kailath, "On spatial smoothing for direction-of-arrival
estimation of coherent signals", IEEE Trans. ASSP 33 (1985).
Carlson, "Covariance matrix estimation errors and diagonal loading in adaptive
arrays", IEEE Trans. AES 24 (1988).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from isacbench.checked_arrays import Floats
from isacbench.dsp.angles.beamformers import capon_spectrum
from isacbench.dsp.angles.planar_spectra import AngularSpectrum
from isacbench.dsp.angles.planar_subspaces import subarray_shape
from isacbench.errors import require

from .angular_spectra import AngularSpectrumEstimator
from .chain import CellSnapshots


@dataclass(frozen=True)
class Capon2d(AngularSpectrumEstimator):
    """2D-FFT with OSCA-CFAR, then Capon's beamformer in every cell.

    Attributes
    ----------
    subarray_fraction : float
        Subarray length over array length, rounded, along u and along w.
    loading_db : float
        Power added to the diagonal of the covariance, over the floor of noise
        and leakage that the detection measures.
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

    name: ClassVar[str] = "capon2d"

    angle_dynamic_range_db: float = 15.0
    subarray_fraction: float = 0.625
    loading_db: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        fraction = self.subarray_fraction
        require(0 < fraction <= 1, "subarray_fraction", fraction, "above 0, up to 1")
        require(abs(self.loading_db) <= 200, "loading_db", self.loading_db, "-200 to 200")

    def angular_spectrum(self, cells: CellSnapshots, u: Floats, w: Floats) -> AngularSpectrum:
        """Compute Capon's spectrum of each cell.

        Parameters
        ----------
        u, w : ndarray of float64, shapes (g,) and (h,)
            Direction cosines of the samples.
        """
        snapshots = cells.own
        subarray = subarray_shape(snapshots.shape[1:], self.subarray_fraction)
        loading = cells.levels.floor * 10 ** (self.loading_db / 10)
        return capon_spectrum(snapshots, subarray, loading, u, w)
