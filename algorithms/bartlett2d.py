"""Bartlett's beamformer in every detected range-Doppler cell: a beam steered to each direction of the region.

For every detected range-Doppler cell the power of the P x Q snapshot behind a
beam, |a^H x|² / (P Q)², is sampled over the directions that the region spans,
and its maxima placed off the grid by Newton's method.

It is the matched filter of one plane wave, and so the best estimator of a wave
that is alone in its cell. Compared with `fft4d` there is no CFAR over the angles: a maximum counts if
it is not more than 12 dB below the strongest.

Cost of n cells, g x h directions: n (h P Q + g h P) for the spectra.

Fails where sources of one cell are closer than a Rayleigh cell (2/P in u,
2/Q in w): they have one maximum, between them or, where they interfere, beside
them. Sources more than 12 dB below another are taken for its sidelobes, which
lie at -13 dB. Those of lines of 3 and 4 elements are higher, at -9.5 and
-11.3 dB, and can be taken for sources.

References
----------
Bartlett, "Smoothing periodograms from time-series with continuous spectra",
Nature 161 (1948).
Van Trees, "Optimum Array Processing", Wiley (2002), chapter 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from isacbench.checked_arrays import Floats
from isacbench.dsp.angles.beamformers import bartlett_spectrum
from isacbench.dsp.angles.planar_spectra import AngularSpectrum

from .angular_spectra import AngularSpectrumEstimator
from .chain import CellSnapshots


@dataclass(frozen=True)
class Bartlett2d(AngularSpectrumEstimator):
    """2D-FFT with OSCA-CFAR, then Bartlett's beamformer in every cell.

    Attributes
    ----------
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

    Examples
    --------
    >>> from isacbench import load_scenario, observe
    >>> cloud = Bartlett2d().estimate(observe(load_scenario("street"), snr_db=10))
    >>> 60 < len(cloud) < 466
    True
    """

    name: ClassVar[str] = "bartlett2d"

    local_dynamic_range_db: float = 14.0
    largest_direction_error: float | None = None

    def angular_spectrum(self, cells: CellSnapshots, u: Floats, w: Floats) -> AngularSpectrum:
        """Compute Bartlett's spectrum of each cell, on all elements.

        Parameters
        ----------
        u, w : ndarray of float64, shapes (g,) and (h,)
            Direction cosines of the samples.
        """
        return bartlett_spectrum(cells.own, u, w)
