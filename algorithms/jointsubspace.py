"""What `music2d_joint` and `esprit2d` share: planar subspaces, their order, and the fit of plane waves.

For every detected range-Doppler cell:

1. All subarrays of the P x Q snapshot, forwards and backwards, give one real
   covariance; its largest eigenvectors span the signal subspace.
2. The estimator itself finds starts for the directions in that subspace.
3. Maximum likelihood refines the directions together on the whole snapshot,
   which has twice the aperture of a subarray. Weak waves and pairs that noise
   does not tell apart leave.

The order is tested against white noise, not against the leakage of strong
cells: two echoes in phase a quarter of a Rayleigh cell apart leave a second
eigenvalue 37 dB below the first. What leakage adds has little power, and is
dropped by its power.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from isacbench.contracts import Spectrum
from isacbench.dsp.detection import power_map, reference_noise
from isacbench.dsp.esprit import most_sources
from isacbench.dsp.kernels import steering
from isacbench.dsp.maxlik import resolve_directions
from isacbench.dsp.model_order import (
    ModelOrder,
    eigenvalue_cfar_order,
    information_order,
    noise_order,
    smoothed_noise_edge,
)
from isacbench.dsp.planewaves import PlaneWaves
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.dsp.subspace2d import leading_eigenpairs, planar_covariance
from isacbench.errors import require
from isacbench.model.observation import Observation

from .cellwise import DETECTION_WINDOW, CellwiseEstimator, Snapshots

__all__ = ["JointSubspaceEstimator", "Subspaces"]

_Axis = Literal["u", "w"]

SPECTRUM_POINTS = 201
"""Samples of the spectra that a diagnosis shows."""


class Subspaces(NamedTuple):
    """Signal subspaces of n cells.

    Attributes
    ----------
    basis : ndarray of float64, shape (n, L, M, k)
        Orthonormal, by descending eigenvalue; 0 beyond the order of a cell.
    order : ndarray of int64, shape (n,)
        Dimension of each, 1 to k.
    """

    basis: NDArray[np.float64]
    order: NDArray[np.int64]


@dataclass(frozen=True)
class JointSubspaceEstimator(CellwiseEstimator):
    """Parameters and steps that the planar subspace methods share; subclasses add how to find directions.

    Attributes
    ----------
    subarray_fraction : float
        Subarray length over array length, rounded, along u and along w.
    model_order : {"noise", "eigenvalue_cfar", "mdl", "aic"}
        Eigenvalues that white noise does not reach, the paper's CA-CFAR over
        the sorted eigenvalues, minimum description length, or Akaike's
        criterion.
    polish : int
        Most steps of maximum likelihood; 0 leaves directions as they come
        out of the subspace.
    detector, pfa, integration, range_window, doppler_window, max_sources, angle_pfa
        See `isacbench_algorithms.cellwise.CellwiseEstimator`. `max_sources` is
        also the largest dimension of a signal subspace.
    dynamic_range_db, local_dynamic_range_db : float
        See `isacbench_algorithms.cellwise.CellwiseEstimator`.

    Raises
    ------
    InputError
        If a parameter is out of range.
    """

    subarray_fraction: float = 0.5
    model_order: ModelOrder = "noise"
    polish: int = 10

    def __post_init__(self) -> None:
        super().__post_init__()
        fraction = self.subarray_fraction
        require(0 < fraction <= 1, "subarray_fraction", fraction, "above 0, up to 1")
        orders = get_args(ModelOrder)
        require(self.model_order in orders, "model_order", self.model_order, f"one of {', '.join(orders)}")
        require(self.polish >= 0, "polish", self.polish, "0 and more")

    def plane_waves(
        self, observation: Observation, snapshots: Snapshots, noise: float, min_power: float
    ) -> PlaneWaves:
        """Directions from the subspaces, refined and told apart on the whole array."""
        white = _white_noise(observation)
        white = noise if white is None else min(white, noise)
        waves = self.directions(observation, self.subspaces(snapshots, white))
        if self.polish:
            waves = resolve_directions(snapshots[:, None], waves, white, self.angle_pfa, self.polish)
        power = np.abs(waves.amplitudes(snapshots[None])[0]) ** 2
        strongest = power.max(axis=1, keepdims=True, initial=0)
        found = waves.found & (power > min_power)
        found &= power > strongest * 10 ** (-self.dynamic_range_db / 10)
        found &= (np.abs(waves.u) <= 1) & (np.abs(waves.w) <= 1) & (waves.u**2 + waves.w**2 <= 1)
        return PlaneWaves(waves.u, waves.w, found)

    @abstractmethod
    def directions(self, observation: Observation, subspaces: Subspaces) -> PlaneWaves:
        """Find as many directions in each subspace as it has dimensions, or fewer.

        Parameters
        ----------
        observation : Observation
        subspaces : Subspaces

        Returns
        -------
        PlaneWaves
            One row a cell.
        """

    def spectra(self, observation: Observation, snapshot: Snapshots, noise: float) -> tuple[Spectrum, ...]:
        """Cuts of the array's power along u and along w through the strongest plane wave, in dB below it."""
        waves = self.plane_waves(observation, snapshot, noise, 0.0)
        power = np.abs(waves.amplitudes(snapshot[None])[0, 0])
        strongest = int(power.argmax())
        towards_u = steering(snapshot.shape[1], waves.u[0, strongest]).conj()
        towards_w = steering(snapshot.shape[2], waves.w[0, strongest]).conj()
        level_db = 20 * np.log10(np.abs(towards_u @ snapshot[0] @ towards_w))

        def cut(
            line: NDArray[np.complex128],
            limits: tuple[float, float],
            places: NDArray[np.float64],
            label: _Axis,
        ) -> Spectrum:
            cosine = np.linspace(*limits, SPECTRUM_POINTS)
            power_db = 20 * np.log10(np.abs(steering(line.size, cosine).conj() @ line))
            return Spectrum(cosine, power_db - level_db, None, places[0][waves.found[0]], label)

        u_limits, w_limits = observation.cosine_limits
        return (
            cut(snapshot[0] @ towards_w, u_limits, waves.u, "u"),
            cut(towards_u @ snapshot[0], w_limits, waves.w, "w"),
        )

    def subspaces(self, snapshots: Snapshots, noise: float) -> Subspaces:
        """Signal subspaces of snapshots (n, P, Q) in white noise of a power per element."""
        shape = snapshots.shape[1:]
        subarray = self.subarray(shape)
        covariance = planar_covariance(snapshots, subarray)
        n_sensors = covariance.shape[1]
        largest = max(min(self.max_sources, most_sources(subarray), n_sensors - 1), 1)
        # One more than may be sources: the last of a test's eigenvalues is never one.
        eigenvalues, eigenvectors = leading_eigenpairs(covariance, largest + 1)
        if self.model_order != "noise":
            eigenvalues = np.linalg.eigvalsh(covariance)[:, ::-1].astype(np.float64, copy=False)
        order = np.minimum(self._order(eigenvalues, noise, shape, subarray), largest)
        in_signal = np.arange(order.max(initial=1)) < order[:, None]
        basis = eigenvectors[:, :, : in_signal.shape[1]] * in_signal[:, None, :]
        return Subspaces(basis.reshape(len(snapshots), *subarray, basis.shape[2]), order)

    def subarray(self, shape: tuple[int, ...]) -> tuple[int, int]:
        """Elements of a subarray along u and along w."""
        n_u, n_w = (min(max(2, round(self.subarray_fraction * n)), n) for n in shape)
        return n_u, n_w

    def _order(
        self,
        eigenvalues: NDArray[np.float64],
        noise: float,
        shape: tuple[int, int],
        subarray: tuple[int, int],
    ) -> NDArray[np.int64]:
        if self.model_order == "noise":
            return noise_order(eigenvalues, noise * smoothed_noise_edge(shape, subarray, self.angle_pfa))
        if self.model_order == "eigenvalue_cfar":
            return eigenvalue_cfar_order(eigenvalues, self.cell_detector().pfa)
        n_independent = np.prod(shape) / np.prod(subarray)
        return information_order(eigenvalues, float(n_independent), self.model_order)


def _white_noise(observation: Observation) -> float | None:
    """Noise power per element where no speed of the region reaches, None where there is no such place."""
    seen = GatedMap(observation.cells, observation.gate).tapered("rect", DETECTION_WINDOW)
    return reference_noise(power_map(seen.cells, "noncoherent")[0], seen.gate)
