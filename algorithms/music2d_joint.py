"""MUSIC with one joint spectrum over u and w in every detected range-Doppler cell.

For every detected range-Doppler cell:

1. Forward-backward smoothing over all subarrays of half the array, 64 sensors
   of 256, and a real eigendecomposition give the signal subspace.
2. The joint spectrum is evaluated over the directions that the region spans,
   separably, and its deepest nulls placed off the grid by Newton's method. A
   pair has one null: nothing is to be paired, and there are no ghosts.
3. In resolved cells (`isacbench_algorithms.joint_subspace`), where the subspace
   has more dimensions than the spectrum has nulls, sources share one. The
   flattest null is split along the axis along which it is flat.
4. There, maximum likelihood on the whole snapshot refines the directions
   together. In crowds, the nulls are taken as they are.

Scatterers that explain the map down to the noise are fitted to it together
(`isacbench_algorithms.joint_subspace`).

A CFAR over the spectrum, as the paper has one, is left out: the reciprocal of
a null is no power of noise, and the order says how many nulls count.

Cost of n cells on P x Q elements, subarrays of L x M, S shifts of them, g x h
grid points and k sources: 2 n (2 S (L M)² + 40 (L M)² + 20 L M k²) for the
subspaces of single and of three cells, n k h L (M + g) for the spectra by each
of three rules, and n (k P Q + k³) a step of the refinement; then what selecting
and fitting the candidates together costs.

Fails where the second eigenvalue drowns: two equal echoes in phase at the
middle of the array and d Rayleigh cells apart leave one of about d⁴ / 20 of
the first. Three sources in one null are split along a line.

References
----------
Schmidt, "Multiple emitter location and signal parameter estimation", IEEE
Trans. AP 34 (1986).
Pillai and Kwon, "Forward/backward spatial smoothing techniques for coherent
signal identification", IEEE Trans. ASSP 37 (1989).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from isacbench.checked_arrays import Floats, Integers
from isacbench.dsp.angles.line_subspaces import SMALLEST_NULL
from isacbench.dsp.angles.peaks import direction_samples, in_rows, numbered
from isacbench.dsp.angles.planar_spectra import Minima
from isacbench.dsp.angles.planar_subspaces import null_minima, planar_null_spectrum
from isacbench.dsp.angles.plane_waves import PlaneWaves
from isacbench.errors import require_least
from isacbench.model.observation import Observation
from isacbench.plugins.contracts import Spectrum

from .chain import CellSnapshots
from .joint_subspace import JointSubspaceEstimator, Subspaces

SAMPLES_PER_LOBE = 16
"""Grid points across the main lobe of a subarray, 4 / L: a null is rounder than the lobe."""

FIRST_SPLIT = 0.5
"""Rayleigh cells of the array between the parts of a split null, at first: sources much farther apart
have nulls of their own, and from outside the refinement closes in on those nearer."""


@dataclass(frozen=True)
class Music2dJoint(JointSubspaceEstimator):
    """2D-FFT with OSCA-CFAR, then MUSIC with one joint spectrum and maximum likelihood in every cell.

    Attributes
    ----------
    samples_per_lobe : int
        Grid points across a subarray's main lobe, along u and along w.
    subarray_fraction, model_order, polish
        See `isacbench_algorithms.joint_subspace.JointSubspaceEstimator`.
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

    name: ClassVar[str] = "music2d_joint"

    samples_per_lobe: int = SAMPLES_PER_LOBE

    def __post_init__(self) -> None:
        super().__post_init__()
        require_least(self, samples_per_lobe=4)

    def directions(self, observation: Observation, subspaces: Subspaces) -> PlaneWaves:
        """Find the nulls of the joint spectra, split in cells with fewer nulls than sources."""
        rayleigh = 2 / np.array(observation.array.shape)
        return _split(self._nulls(observation, subspaces), subspaces.order, rayleigh)

    def unresolved_directions(self, observation: Observation, subspaces: Subspaces) -> PlaneWaves:
        """Find the nulls of the joint spectra, none of them split."""
        nulls = self._nulls(observation, subspaces)
        return PlaneWaves(*in_rows(len(subspaces.order), nulls.cell, *nulls.place.T))

    def spectra(self, observation: Observation, cells: CellSnapshots) -> tuple[Spectrum, ...]:
        """Cut the first cell's joint spectrum through its deepest null, in dB above an empty direction."""
        subspaces = self.subspaces(cells, self.eigenpairs(cells), cells.levels.white)
        nulls, basis = self._nulls(observation, subspaces), subspaces.basis
        n_sensors = basis.shape[1] * basis.shape[2]
        waves = self.all_waves(observation, cells)
        if not nulls.cell.size:
            return ()

        def cut(cosine: Floats, null: Floats, places: Floats, label: Literal["u", "w"]) -> Spectrum:
            level_db = -10 * np.log10(np.maximum(null / n_sensors, SMALLEST_NULL))
            return Spectrum(cosine, level_db, None, places[0][waves.found[0]], label)

        u, w = self._grid(observation, subspaces)
        return (
            cut(u, planar_null_spectrum(basis, u, nulls.place[:1, 1])[0, :, 0], waves.u, "u"),
            cut(w, planar_null_spectrum(basis, nulls.place[:1, 0], w)[0, 0], waves.w, "w"),
        )

    def _nulls(self, observation: Observation, subspaces: Subspaces) -> Minima:
        """As many of the deepest nulls of each joint spectrum as its subspace has dimensions, or fewer."""
        return null_minima(subspaces.basis, *self._grid(observation, subspaces), subspaces.order)

    def _grid(self, observation: Observation, subspaces: Subspaces) -> tuple[Floats, Floats]:
        """Samples over the directions that the region spans."""
        widest = [4 / (n * self.samples_per_lobe) for n in subspaces.basis.shape[1:3]]
        return direction_samples(observation.cosine_limits, widest)


def _split(nulls: Minima, order: Integers, rayleigh: Floats) -> PlaneWaves:
    """Directions of nulls, as many as the order of each cell, the flattest nulls split along a line."""
    cell = nulls.cell
    n_nulls = np.bincount(cell, minlength=len(order))[cell]
    share, rest = np.divmod(order[cell] - n_nulls, n_nulls)
    # In Rayleigh cells, so that both axes count alike.
    flatness, axes = np.linalg.eigh(nulls.curvature * np.multiply.outer(rayleigh, rayleigh))
    flattest = np.lexsort([flatness[:, 0], cell])
    n_parts = 1 + share
    n_parts[flattest] += numbered(cell) < rest
    owner = np.repeat(np.arange(cell.size), n_parts)
    part = np.arange(owner.size) - (np.cumsum(n_parts) - n_parts)[owner]
    offset = FIRST_SPLIT * (part - (n_parts[owner] - 1) / 2)
    place = nulls.place[owner] + offset[:, None] * axes[owner, :, 0] * rayleigh
    return PlaneWaves(*in_rows(len(order), cell[owner], *place.T))
