"""2-D unitary ESPRIT in every detected range-Doppler cell: directions without a grid, paired from the start.

For every detected range-Doppler cell:

1. Forward-backward smoothing over all subarrays of 5/8 of the array and a
   real eigendecomposition give the signal subspace; its dimension is the
   number of eigenvalues that noise does not reach, by default.
2. The shift of the subarray along u and that along w give two small real
   matrices with common eigenvectors; the eigenvalues of the one plus j times
   the other hold u and w in pairs. No spectrum, no grid, no pairing step. Where
   the pairs are not reliable, the cell is solved anew with one source less.
3. In resolved cells, maximum likelihood on the whole snapshot refines the
   directions together. In crowds, a cell is solved with fewer sources until
   all lie where the region is (`isacbench_algorithms.joint_subspace`).

Scatterers that explain the map down to the noise are fitted to it together
(`isacbench_algorithms.joint_subspace`).

Cost of n cells on P x Q elements, subarrays of L x M, S shifts of them and k
sources: 2 n (2 S (L M)² + 40 (L M)² + 20 L M k²) for the subspaces of single
and of three cells, n (L M k² + k³) for the directions by each of three rules,
and n (k P Q + k³) a step of the refinement; then m (15 P Q + m²) for m
candidates.

Fails where the second eigenvalue drowns: two equal echoes in phase at the
middle of the array and d Rayleigh cells apart leave one of about d⁴ / 20 of
the first. More sources in a cell than `max_sources` are seen as fewer, between
them.

References
----------
Zoltowski, Haardt and Mathews, "Closed-form 2-D angle estimation with
rectangular arrays in element space or beamspace via unitary ESPRIT", IEEE
Trans. SP 44 (1996).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from isacbench.checked_arrays import Mask
from isacbench.dsp.angles.planar_subspaces import EspritDirections, unitary_esprit
from isacbench.dsp.angles.plane_waves import PlaneWaves
from isacbench.model.observation import Observation

from .joint_subspace import JointSubspaceEstimator, Subspaces


@dataclass(frozen=True)
class Esprit2d(JointSubspaceEstimator):
    """2D-FFT with OSCA-CFAR, then 2-D unitary ESPRIT and maximum likelihood in every cell.

    Attributes
    ----------
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

    name: ClassVar[str] = "esprit2d"

    local_dynamic_range_db: float = 14.0
    largest_direction_error: float | None = None
    subarray_fraction: float = 0.625

    def directions(self, observation: Observation, subspaces: Subspaces) -> PlaneWaves:
        """Find the directions of the most sources that noise has not separated along the wrong axis."""
        return _most_directions(subspaces, lambda found: found.reliable)

    def unresolved_directions(self, observation: Observation, subspaces: Subspaces) -> PlaneWaves:
        """Find directions of the most sources that all lie in the region: ghosts of crowds often do not."""
        (lowest_u, highest_u), (lowest_w, highest_w) = observation.cosine_limits

        def inside(waves: EspritDirections | PlaneWaves) -> Mask:
            u, w = observation.unfolded(waves.u, waves.w)
            in_u: Mask = (u >= lowest_u) & (u <= highest_u)
            return in_u & (w >= lowest_w) & (w <= highest_w)

        waves = _most_directions(subspaces, lambda found: found.reliable & inside(found).all(axis=1))
        return replace(waves, found=waves.found & inside(waves))


def _most_directions(subspaces: Subspaces, accepted: Callable[[EspritDirections], Mask]) -> PlaneWaves:
    """Directions of the most sources of each cell that are accepted together; a lone one always is."""
    basis, order = subspaces[0], subspaces[1].copy()
    u, w = np.zeros((2, len(basis), basis.shape[3]))
    # From above, so that a cell that is refused joins those of the order below.
    for k in range(int(order.max(initial=1)), 0, -1):
        cells = np.flatnonzero(order == k)
        found = unitary_esprit(basis[cells, :, :, :k])
        u[cells, :k], w[cells, :k] = found.u, found.w
        order[cells[~accepted(found)]] = max(k - 1, 1)
    return PlaneWaves(u, w, np.arange(basis.shape[3]) < order[:, None])
