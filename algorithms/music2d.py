"""The paper's method: 2D-FFT and OSCA-CFAR for range and velocity, row and column MUSIC for the angles.

For every detected range-Doppler cell:

1. The P x Q snapshot is read twice, as P rows and as Q columns of subarrays;
   with ``integration="element"``, as one row and one column.
   Forward-backward smoothing restores the rank that coherent echoes of one
   cell lack; eigenvalues above the noise edge span the signal subspace.
2. The MUSIC spectrum over u and the one over w are each evaluated in 1-D,
   their peaks tested by CA-CFAR and placed off the grid by Newton's method.
   With ``search="root"`` the roots of the spectra's polynomials take their
   place: root-MUSIC, without samples and without a CFAR.
   The product spectrum of the paper peaks at every intersection of the two.
3. The joint response of all elements that are read tells sources from ghosts
   among the intersections. With ``pairing="product"`` every intersection whose
   product passes a 2-D CA-CFAR is a source, as the paper has it.

Differences from the paper, each measured in ``docs/errata.md``: thresholds
follow from P_fa; the order statistic of OSCA runs along Doppler; leakage of
strong scatterers bounds the dynamic range; the angles of a cell follow from the
data, up to `max_order` along each axis and `max_sources` in all.

Cost of n cells on P x Q elements, subarrays of L, g grid points and k sources:
n (P Q L² + L³ + L k g) for the spectra and n (k⁴ + k P Q) for the pairs.

Fails where sources of one cell are closer than a third to a half of a Rayleigh
cell and comparable in power: they merge into one between them.

References
----------
arXiv 2310.06401.
Barabell, "Improving the resolution performance of eigenstructure-based
direction-finding algorithms", ICASSP (1983): root-MUSIC.
Schmidt, "Multiple emitter location and signal parameter estimation", IEEE
Trans. AP 34 (1986).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal, NamedTuple, get_args

import numpy as np

from isacbench.checked_arrays import Complex, Floats, Integers, parts_of
from isacbench.dsp.angles.line_subspaces import (
    SMALLEST_NULL,
    Eigenpairs,
    line_eigenpairs,
    music_null_minima,
    music_null_spectrum,
    music_roots,
    real_steering,
)
from isacbench.dsp.angles.model_order import ModelOrder, noise_edge, smoothed_noise_edge, source_count
from isacbench.dsp.angles.peaks import (
    Peaks,
    cosine_samples,
    in_rows,
    line_maxima,
    line_peaks,
    strongest,
    with_neighbours,
)
from isacbench.dsp.angles.plane_waves import PlaneWaves, pair_directions
from isacbench.dsp.cell_detection import Integration
from isacbench.dsp.detection import detect_listed
from isacbench.errors import require, require_least, require_option
from isacbench.instrument.stages import stage
from isacbench.model.kernels import PERIOD, within_period
from isacbench.model.observation import Observation
from isacbench.model.region import Interval
from isacbench.plugins.contracts import Detector, Spectrum

from .chain import CellPrecision, CellSnapshots, CellwiseEstimator, determined_order
from .detectors import CaCfar, OscaCfar

MIN_GRID_POINTS = 65
"""Samples that the default window of the spectrum's CFAR needs."""

SINGLE_LINE_PFA = 1e-2
"""Chance that the noise of one line of sensors looks like another source; the pairing has yet to pass it."""

POLE_OFFSET = 1 / 4
"""Samples from a source within which spectra are as high as at this distance."""

PRODUCT_TRAINING, PRODUCT_GUARD = (0, 24, 24), (0, 8, 8)
"""Samples to either side of a peak of the product spectrum, along u and along w; each cell is a map."""

CELLS_AT_A_TIME = 64
"""Cells whose product spectra are in memory together: 20 MB of 201 x 201 points."""

Search = Literal["grid", "root"]
"""Directions of a line: peaks of its sampled spectrum, or roots of its polynomial (root-MUSIC)."""

Pairing = Literal["joint", "product"]
"""Intersections that are plane waves: those of the joint response, or the peaks of the product spectrum."""


class MusicSpectra(NamedTuple):
    """MUSIC spectra of n cells along one direction cosine, and the peaks that pass their test.

    Attributes
    ----------
    cosine : ndarray of float64, shape (g,)
    spectra : ndarray of float64, shape (n, g)
        1 in an empty direction.
    peaks : Peaks
        Direction cosines of the peaks that pass.
    """

    cosine: Floats
    spectra: Floats
    peaks: Peaks

    def heights(self) -> tuple[Integers, Floats]:
        """Find the samples nearest to the peaks, and the spectra there.

        Returns
        -------
        samples : ndarray of int64, shape (n, k)
        heights : ndarray of float64, shape (n, k)
        """
        step = self.cosine[1] - self.cosine[0]
        steps = ((self.peaks.place - self.cosine[0] + step / 2) % PERIOD) // step
        samples = np.minimum(steps.astype(np.int64), self.cosine.size - 1)
        return samples, np.take_along_axis(self.spectra, samples, axis=1)

    def first(self, label: Literal["u", "w"], detector: Detector) -> Spectrum:
        """First of the spectra and its threshold, in dB above an empty direction."""
        return Spectrum(
            self.cosine,
            10 * np.log10(self.spectra[0]),
            10 * np.log10(detector.detect(self.spectra).threshold[0]),
            self.peaks.place[0][self.peaks.found[0]],
            label,
        )


@dataclass(frozen=True)
class Music2d(CellwiseEstimator):
    """2D-FFT with OSCA-CFAR, then MUSIC along rows and columns of the virtual array (the paper).

    Attributes
    ----------
    subarray_fraction : float
        Subarray length over array length, rounded, along u and along w.
    grid_points : int
        Samples of each spectrum over the directions that the region spans.
    model_order : {"noise", "eigenvalue_cfar", "mdl", "aic"}
        Eigenvalues above the edge of the noise, the paper's CA-CFAR over the
        sorted eigenvalues, minimum description length, or Akaike's criterion.
    max_order : int
        Most sources along u, and along w.
    spectrum_detector : Detector
        Of peaks in a stack of spectra (cells, grid).
    search : {"grid", "root"}
        Peaks of the spectra that pass their CFAR, or the roots of the null
        spectra's polynomials that are nearest to the unit circle (root-MUSIC),
        which need neither `grid_points` nor `spectrum_detector`.
    pairing : {"joint", "product"}
        Joint response of the elements, or the paper's: the local maxima of the
        product of a cell's two spectra that pass a 2-D CA-CFAR (`PRODUCT_TRAINING`
        and `PRODUCT_GUARD` samples) are plane waves, ghosts among them. The two
        spectra are then not tested one by one.
    product_pfa : float
        Of that CA-CFAR.
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
    >>> cloud = Music2d().estimate(observe(load_scenario("street"), snr_db=10))
    >>> 100 < len(cloud) < 466
    True
    """

    name: ClassVar[str] = "music2d"
    separable: ClassVar[bool] = True

    detector: Detector = field(default_factory=lambda: OscaCfar(order_axis=1))
    integration: Integration = "noncoherent"
    dynamic_range_db: float = 33.0
    precision: CellPrecision = "single"
    subarray_fraction: float = 0.625
    grid_points: int = 201
    model_order: ModelOrder = "noise"
    max_order: int = 4
    spectrum_detector: Detector = field(
        default_factory=lambda: CaCfar(pfa=0.3, training=(0, 24), guard=(0, 8))
    )
    search: Search = "grid"
    pairing: Pairing = "joint"
    product_pfa: float = 1e-3

    def __post_init__(self) -> None:
        super().__post_init__()
        fraction = self.subarray_fraction
        require(0 < fraction <= 1, "subarray_fraction", fraction, "above 0, up to 1")
        require_option(self, "model_order", get_args(ModelOrder))
        require_least(self, grid_points=MIN_GRID_POINTS, max_order=1)
        require_option(self, "search", get_args(Search))
        pairings = get_args(Pairing) if self.search == "grid" else ("joint",)
        allowed = f"{' or '.join(pairings)} with search = {self.search}"
        require(self.pairing in pairings, "pairing", self.pairing, allowed)
        require(0 < self.product_pfa < 1, "product_pfa", self.product_pfa, "above 0, below 1")

    def plane_waves(self, observation: Observation, cells: CellSnapshots) -> PlaneWaves:
        """Pair the peaks of the row and the column spectra by the joint response of the array.

        Returns
        -------
        PlaneWaves
            One row a cell.
        """
        aperture, min_power = self.aperture(observation), cells.levels.min_power
        in_u, in_w = self.subspaces(observation, cells)
        with stage("peaks"):
            if self.pairing == "product":
                waves = self.product_peaks(self.line_music(*in_u), self.line_music(*in_w))
                beams = aperture.towards(waves.u, waves.w).matched(cells.own[None])[0]
                return replace(waves, found=waves.found & (np.abs(beams) ** 2 > min_power))
            along_u, along_w = self.line_directions(*in_u), self.line_directions(*in_w)
            return pair_directions(
                cells.own, aperture, along_u, along_w, min_power, self.dynamic_range_db, self.max_sources
            )

    def subspaces(
        self, observation: Observation, cells: CellSnapshots
    ) -> list[tuple[Floats, Integers, Interval]]:
        """Estimate signal subspaces along columns and along rows, with the cosines that the region spans."""
        lines = self.aperture(observation).lines(cells.own)
        return [
            (*self.line_subspaces(each, cells.levels.floor), limits)
            for each, limits in zip(lines, observation.cosine_limits, strict=True)
        ]

    def product_peaks(self, along_u: MusicSpectra, along_w: MusicSpectra) -> PlaneWaves:
        """Find the local maxima of the product of two spectra that pass a 2-D CA-CFAR.

        A product of positive spectra has its local maxima where both factors have one.

        Parameters
        ----------
        along_u, along_w : MusicSpectra
            Of the same cells.

        Returns
        -------
        PlaneWaves
            The highest `max_sources` of each cell.
        """
        detector = CaCfar(self.product_pfa, PRODUCT_TRAINING, PRODUCT_GUARD)
        (row, u_height), (column, w_height) = along_u.heights(), along_w.heights()
        passed = along_u.peaks.found[:, :, None] & along_w.peaks.found[:, None]
        for some in parts_of(len(passed), CELLS_AT_A_TIME):
            product = along_u.spectra[some, :, None] * along_w.spectra[some, None]
            cell, i, j = maxima = np.nonzero(passed[some])
            places = cell, row[some][cell, i], column[some][cell, j]
            passed[some][maxima] = detect_listed(detector, product, 1, places).mask
        cell, i, j = np.nonzero(passed)
        most = np.full(len(passed), self.max_sources)
        chosen = strongest(u_height[cell, i] * w_height[cell, j], cell, most)
        cell, i, j = cell[chosen], i[chosen], j[chosen]
        u, w = along_u.peaks.place[cell, i], along_w.peaks.place[cell, j]
        return PlaneWaves(*in_rows(len(passed), cell, u, w))

    def spectra(self, observation: Observation, cells: CellSnapshots) -> tuple[Spectrum, ...]:
        """MUSIC spectra of the first cell over u and over w."""
        along_u, along_w = (
            self.line_music(*each)._replace(peaks=self.line_directions(*each))
            for each in self.subspaces(observation, cells)
        )
        return along_u.first("u", self.spectrum_detector), along_w.first("w", self.spectrum_detector)

    def line_subspaces(self, lines: Complex, noise: float) -> tuple[Floats, Integers]:
        """Estimate signal subspaces along the sensors of lines.

        Parameters
        ----------
        lines : ndarray of complex, shape (n, sensors, snapshots)
            Of n cells.
        noise : float
            Power per element.

        Returns
        -------
        vectors : ndarray of float64, shape (n, L, L)
            Eigenvectors of the smoothed covariances, by descending eigenvalue.
        order : ndarray of int64, shape (n,)
            Dimensions of the signal subspaces.
        """
        n_subarray = max(2, round(self.subarray_fraction * lines.shape[1]))
        with stage("subspace"):
            pairs = line_eigenpairs(lines, n_subarray)
            sources = self.signal_order(pairs, lines.shape, noise)
            return pairs.vectors, determined_order(pairs, np.minimum(sources, self.max_order))

    def line_directions(self, vectors: Floats, order: Integers, limits: Interval) -> Peaks:
        """Find the directions of signal subspaces: peaks of the MUSIC spectra that pass, or roots.

        Parameters
        ----------
        vectors, order
            From `line_subspaces`.
        limits : (float, float)
            Direction cosines that the region spans.
        """
        if self.search == "grid":
            return self.line_music(vectors, order, limits).peaks
        with stage("spectrum"):
            return music_roots(vectors, order, limits)

    def line_music(self, vectors: Floats, order: Integers, limits: Interval) -> MusicSpectra:
        """Evaluate MUSIC spectra, test their local maxima by CFAR, and place the peaks off the grid.

        Parameters
        ----------
        vectors, order, limits
            As for `line_directions`.
        """
        n_subarray = vectors.shape[1]
        cosine = cosine_samples(limits, (limits[1] - limits[0]) / (self.grid_points - 1))
        step = cosine[1] - cosine[0]
        with stage("spectrum"):
            null = music_null_spectrum(vectors, order, real_steering(n_subarray, cosine))
            spectra = n_subarray / np.maximum(null, _sampled_null(n_subarray, step) * n_subarray)
        # A parabola fits a null, and not the pole that its reciprocal is.
        framed, (places,) = with_neighbours(-null, [cosine])
        cell, sample = line_maxima(framed)
        if self.pairing == "joint":
            cells = cell, (sample - (places.size - cosine.size) // 2) % cosine.size
            passed = detect_listed(self.spectrum_detector, spectra, 1, cells).mask
            cell, sample = cell[passed], sample[passed]
        peaks = line_peaks(framed, places, order, (cell, sample))
        minima = music_null_minima(vectors, order, peaks.place, peaks.found, step)
        return MusicSpectra(cosine, spectra, Peaks(within_period(minima), peaks.found))

    def signal_order(self, pairs: Eigenpairs, shape: tuple[int, ...], noise: float) -> Integers:
        """Count the eigenvalues that belong to sources, by the test of `model_order`.

        Parameters
        ----------
        pairs : Eigenpairs
            Of n smoothed covariances.
        shape : (int, int, int)
            Of the lines that they come from: n, sensors, snapshots.
        noise : float
            Power per element.

        Returns
        -------
        ndarray of int64, shape (n,)
        """
        _, n_sensors, n_snapshots = shape
        n_subarray = pairs.vectors.shape[1]
        if n_snapshots > 1:
            edge = noise_edge(n_subarray, 2 * n_snapshots)
        else:  # the subarrays of one snapshot are not independent, and too few for the law of many
            edge = smoothed_noise_edge((n_sensors, 1), (n_subarray, 1), SINGLE_LINE_PFA)
        # Of disjoint subarrays, each snapshot holds as many as fit.
        n_independent = n_snapshots * n_sensors / n_subarray
        return source_count(pairs, self.model_order, noise * edge, self.cell_detector().pfa, n_independent)


def _sampled_null(n_subarray: int, step: float) -> float:
    """Null spectrum over n_subarray at `POLE_OFFSET` samples from a lone source, the least that is used.

    Without noise a sample near a pole would be so high that it hides all other
    sources from a CFAR.
    """
    offset = np.pi * POLE_OFFSET * step
    return float(max(offset**2 * (n_subarray**2 - 1) / 12, SMALLEST_NULL))
