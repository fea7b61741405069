"""Base of `music2d_joint` and `esprit2d`: planar subspaces, resolved cells, and crowds.

The detected cells are read three times (`isacbench_algorithms.chain`):

1. *Resolved cells.* All subarrays of a cell's P x Q snapshot, forwards and
   backwards, give one real covariance, whose largest eigenvectors span the
   signal subspace. Its order is tested against white noise: two echoes in phase
   a quarter of a Rayleigh cell apart leave a second eigenvalue 37 dB below the
   first. The estimator finds starts for the directions in that subspace, and
   maximum likelihood refines them on the whole snapshot. What comes out counts
   only where it explains the cell down to the noise.
2. *Crowds*, where it does not: more echoes than can be resolved, and a
   search as fine as the first invents ghosts. Three neighbouring range cells
   behind low sidelobes give one covariance, whose order is tested against the
   leakage of the strongest cells.
3. The same on single cells.

In crowds, plane waves stay only where their cell determines their direction.
If scatterers selected from all three snapshot rules explain the map down to the
noise, they are moved together in range, velocity, u and w to the least-squares
fit, which brings them to the Cramér-Rao bound. Otherwise there is a crowd, and
the selected scatterers and those of the last rule are points.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, get_args

import numpy as np

from isacbench.checked_arrays import Complex, Floats, Integers
from isacbench.dsp.angles.line_subspaces import Eigenpairs, signal_basis
from isacbench.dsp.angles.model_order import ModelOrder, smoothed_noise_edge, source_count
from isacbench.dsp.angles.planar_subspaces import most_sources, planar_eigenpairs, subarray_shape
from isacbench.dsp.angles.plane_waves import PlaneWaves
from isacbench.dsp.fitting.joint_selection import MatchedFilters, explain_map, select_jointly
from isacbench.dsp.fitting.maximum_likelihood import resolve_directions
from isacbench.dsp.scatterers import LocatedScatterers
from isacbench.errors import require, require_least, require_option
from isacbench.instrument.stages import stage
from isacbench.model.cloud import PointCloud
from isacbench.model.kernels import steering
from isacbench.model.observation import Observation
from isacbench.model.region import Interval
from isacbench.plugins.contracts import Spectrum

from .chain import (
    CellSnapshots,
    CellwiseEstimator,
    Detected,
    Levels,
    ReadMap,
    SnapshotRule,
    detect,
    determined,
    determined_order,
    locate,
    merge_scatterers,
    read_cells,
    read_map,
)

UNRESOLVED = SnapshotRule("hamming", "soft", range_cells=3, one_doppler=True)
"""Low sidelobes along range, so that a cell shows what is near, and the mean direction of three."""

LEAST_NOISE = 1e-8
"""Times the floor for leakage: noise that every explained map may hold."""

FIT_ROUNDING = 1e-16
"""Times the strongest scatterer's power: remainder of a joint fit whose equations are loaded by 1e-9."""

MOST_LEFT_OF_CELL = 1.5
"""Times white noise: largest remainder of a cell that plane waves explain. 256 elements scatter by 0.06."""

LEAST_EXPLAINED = 10**1.8
"""Least power of a cell over its remainder, 18 dB: in more noise a crowd looks like a few waves."""

SPECTRUM_POINTS = 201
"""Samples of the spectra that a diagnosis shows."""


class Subspaces(NamedTuple):
    """Signal subspaces of n cells.

    Attributes
    ----------
    basis : ndarray of float64, shape (n, L, M, k)
        Orthonormal, by descending eigenvalue; 0 beyond the order of a cell.
    order : ndarray of int64, shape (n,)
        Dimension of each, 0 to k: 0 where signal and noise are not separated.
    """

    basis: Floats
    order: Integers


@dataclass(frozen=True)
class JointSubspaceEstimator(CellwiseEstimator):
    """Parameters and steps that the planar subspace methods share; subclasses find the directions.

    Attributes
    ----------
    subarray_fraction : float
        Subarray length over array length, rounded, along u and along w.
    model_order : {"noise", "eigenvalue_cfar", "mdl", "aic"}
        Eigenvalues that white noise does not reach, the paper's CA-CFAR over
        the sorted eigenvalues, minimum description length, or Akaike's
        criterion.
    polish : int
        Most steps of maximum likelihood in resolved cells; 0 leaves directions
        as they come out of the subspace.
    detector, pfa, integration, range_window, doppler_window, max_sources, angle_pfa
        See `isacbench_algorithms.chain.CellwiseEstimator`. `max_sources` is
        also the largest dimension of a signal subspace.
    dynamic_range_db, local_dynamic_range_db, precision, detection_window, largest_direction_error,
    range_excess, doppler_excess
        See `isacbench_algorithms.chain.CellwiseEstimator`.

    Raises
    ------
    InputError
        If a parameter is out of range.
    """

    local_dynamic_range_db: float = 18.0
    subarray_fraction: float = 0.5
    model_order: ModelOrder = "noise"
    polish: int = 10

    def __post_init__(self) -> None:
        super().__post_init__()
        fraction = self.subarray_fraction
        require(0 < fraction <= 1, "subarray_fraction", fraction, "above 0, up to 1")
        require_option(self, "model_order", get_args(ModelOrder))
        require_least(self, polish=0)

    def estimate(self, observation: Observation) -> PointCloud:
        """Image one observation by the stages in order, those of the cells once for each snapshot rule."""
        rdm = read_map(observation, self)  # 2D-FFT
        detected = detect(rdm, self)  # OSCA-CFAR
        if not detected.cells.bins[0].size:
            return PointCloud.empty()
        by_rule = []
        for cells in self.readings(rdm, detected):
            waves = self.waves(observation, cells)  # maximum likelihood in resolved cells
            waves = determined(cells, waves, self)  # no directions between scatterers
            located = locate(cells, waves, self)  # range and velocity
            by_rule.append(self.sidelobe_test(self.own_cell_test(located), rdm, detected.levels))
        found = self.explain(rdm, detected.levels, by_rule)  # least-squares fit, if that explains the map
        return self.to_cloud(rdm, found)

    def readings(self, rdm: ReadMap, detected: Detected) -> tuple[CellSnapshots, ...]:
        """Read the cells by each snapshot rule; single cells are read and decomposed once.

        Those that a beam shows alone are among the single cells of the last rule.
        """
        resolved, crowds, single = self.snapshot_rules()
        cells = read_cells(rdm, detected, single)
        cells = replace(cells, pairs=self.eigenpairs(cells.clear))
        return replace(cells.clear, rule=resolved), read_cells(rdm, detected, crowds).clear, cells

    def plane_waves(self, observation: Observation, cells: CellSnapshots) -> PlaneWaves:
        """Find directions down to the noise in snapshots of resolved cells, and those of crowds in others.

        Returns
        -------
        PlaneWaves
            One row a cell.
        """
        pairs = cells.pairs or self.eigenpairs(cells)
        with stage("peaks"):
            if cells.rule.resolved_only:
                waves = self.resolved_waves(observation, cells, pairs)
            else:
                subspaces = self.subspaces(cells, pairs, cells.levels.floor)
                waves = self.unresolved_directions(observation, subspaces)
            power = np.abs(waves.amplitudes(cells.own[None], self.aperture(observation))[0]) ** 2
            strongest = power.max(axis=1, keepdims=True, initial=0)
            found = waves.found & (power > cells.levels.min_power)
            found &= power > strongest * 10 ** (-self.dynamic_range_db / 10)
            found &= observation.sees(waves.u, waves.w)
            return replace(waves, found=found)

    def resolved_waves(self, observation: Observation, cells: CellSnapshots, pairs: Eigenpairs) -> PlaneWaves:
        """Find directions in cells whose sources can be resolved, by maximum likelihood in the end.

        Returns
        -------
        PlaneWaves
            None in cells that they do not explain down to the noise.
        """
        white, snapshots = cells.levels.white, cells.own
        power = np.mean(np.abs(snapshots) ** 2, axis=(1, 2))
        waves = self.directions(observation, self.subspaces(cells, pairs, white))
        # In as much noise, even if there were half of it, no cell is resolved.
        waves = replace(waves, found=waves.found & (power > LEAST_EXPLAINED * white / 2)[:, None])
        if self.polish:
            with stage("refinement"):
                waves = resolve_directions(snapshots[:, None], waves, white, self.angle_pfa, self.polish)
        unexplained = waves.unexplained(snapshots, self.aperture(observation))
        resolved = (unexplained < MOST_LEFT_OF_CELL * white) & (power > LEAST_EXPLAINED * unexplained)
        return replace(waves, found=waves.found & resolved[:, None])

    def snapshot_rules(self) -> tuple[SnapshotRule, ...]:
        """Resolved cells first, then crowds: means of three range cells, then single cells."""
        single = SnapshotRule(self.range_window, self.doppler_window)
        return replace(single, resolved_only=True), UNRESOLVED, replace(single, one_doppler=True)

    def explain(
        self, rdm: ReadMap, levels: Levels, by_rule: Sequence[LocatedScatterers]
    ) -> LocatedScatterers:
        """Fit scatterers to the map in all coordinates if they explain it.

        Parameters
        ----------
        by_rule : sequence of LocatedScatterers
            Candidates of each snapshot rule. Those of a later rule join if the
            scatterers selected before leave them unexplained.

        Returns
        -------
        LocatedScatterers
            Where they do not explain the map, those selected and those of the last rule.
        """
        with stage("refinement"):
            selected = MatchedFilters(LocatedScatterers.empty(), rdm.gated, rdm.observation.system)
            for candidates in by_rule:
                filters = selected.join(merge_scatterers(candidates))
                limit_db = self.local_dynamic_range_db
                selected = select_jointly(filters, levels.min_power, limit_db, len(selected))
            rounding = FIT_ROUNDING * float(selected.scatterers.power.max(initial=0.0))
            noise = max(levels.white, LEAST_NOISE * levels.floor, rounding)
            explained = explain_map(selected, noise)
        if explained is not None:
            return explained
        return merge_scatterers(selected.scatterers.join(by_rule[-1]))

    @abstractmethod
    def directions(self, observation: Observation, subspaces: Subspaces) -> PlaneWaves:
        """Find as many directions in each subspace as it has dimensions, or fewer.

        Returns
        -------
        PlaneWaves
            One row a cell.
        """

    @abstractmethod
    def unresolved_directions(self, observation: Observation, subspaces: Subspaces) -> PlaneWaves:
        """Find directions in subspaces that hold more sources than dimensions; those are never split.

        Returns
        -------
        PlaneWaves
            One row a cell.
        """

    def spectra(self, observation: Observation, cells: CellSnapshots) -> tuple[Spectrum, ...]:
        """Cut the array's power along u and along w through the strongest plane wave, in dB below it."""
        waves = self.all_waves(observation, cells)
        snapshot = cells.own
        power = np.abs(waves.amplitudes(snapshot[None], self.aperture(observation))[0, 0])
        strongest = int(power.argmax())
        towards_u = steering(snapshot.shape[1], waves.u[0, strongest]).conj()
        towards_w = steering(snapshot.shape[2], waves.w[0, strongest]).conj()
        level_db = 20 * np.log10(np.abs(towards_u @ snapshot[0] @ towards_w))

        def cut(line: Complex, limits: Interval, places: Floats, label: Literal["u", "w"]) -> Spectrum:
            cosine = np.linspace(*limits, SPECTRUM_POINTS)
            power_db = 20 * np.log10(np.abs(steering(line.size, cosine).conj() @ line))
            return Spectrum(cosine, power_db - level_db, None, places[0][waves.found[0]], label)

        u_limits, w_limits = observation.cosine_limits
        return (
            cut(snapshot[0] @ towards_w, u_limits, waves.u, "u"),
            cut(towards_u @ snapshot[0], w_limits, waves.w, "w"),
        )

    def all_waves(self, observation: Observation, cells: CellSnapshots) -> PlaneWaves:
        """Find plane waves of any power, which a diagnosis shows."""
        return self.plane_waves(observation, replace(cells, levels=cells.levels._replace(min_power=0.0)))

    def eigenpairs(self, cells: CellSnapshots) -> Eigenpairs:
        """Decompose the smoothed covariance of each cell's snapshots: one pair more than may be sources."""
        with stage("subspace"):
            subarray = subarray_shape(cells.own.shape[1:], self.subarray_fraction)
            n_sensors = subarray[0] * subarray[1]
            # The last of a test's eigenvalues is never a source.
            n_pairs = self._most_sources(subarray) + 1 if self.model_order == "noise" else n_sensors
            return planar_eigenpairs(cells.snapshots, subarray, n_pairs)

    def subspaces(self, cells: CellSnapshots, pairs: Eigenpairs, noise: float) -> Subspaces:
        """Take the signal subspaces of cells.

        Parameters
        ----------
        pairs : Eigenpairs
            From `eigenpairs`.
        noise : float
            Power per element.
        """
        with stage("subspace"):
            shape = cells.own.shape[1], cells.own.shape[2]
            subarray = subarray_shape(shape, self.subarray_fraction)
            sources = self.signal_order(pairs, shape, subarray, noise)
            order = determined_order(pairs, np.minimum(sources, self._most_sources(subarray)))
            basis = signal_basis(pairs.vectors, order)
            return Subspaces(basis.reshape(len(order), *subarray, basis.shape[2]), order)

    def _most_sources(self, subarray: tuple[int, int]) -> int:
        """Largest dimension of a signal subspace."""
        return max(min(self.max_sources, most_sources(subarray)), 1)

    def signal_order(
        self, pairs: Eigenpairs, shape: tuple[int, int], subarray: tuple[int, int], noise: float
    ) -> Integers:
        """Count the eigenvalues that belong to sources, by the test of `model_order`.

        Parameters
        ----------
        pairs : Eigenpairs
            Of n smoothed covariances.
        shape, subarray : (int, int)
            Elements of the array and of its subarrays, along u and along w.
        noise : float
            Power per element.

        Returns
        -------
        ndarray of int64, shape (n,)
        """
        largest_noise = noise * smoothed_noise_edge(shape, subarray, self.angle_pfa)
        n_independent = float(np.prod(shape) / np.prod(subarray))
        pfa = self.cell_detector().pfa
        return source_count(pairs, self.model_order, largest_noise, pfa, n_independent)
