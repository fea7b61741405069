"""Truth merged in Rayleigh cells: a reference for plots of estimators, not a limit to them.

Scatterers of one Rayleigh cell in range, velocity, u and w are replaced by
their centroid. The cells are the radio's own: a range bin, a velocity bin,
and 2/P and 2/Q in direction cosine (2/16 on the 16 x 16 array).

The number of merged scatterers depends on the borders of the lattice of cells:
1e-13 m of jitter changes the score of a scene with scatterers on a border.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isacbench.errors import InputError
from isacbench.model.cloud import PointCloud
from isacbench.model.observation import Observation
from isacbench.plugins.contracts import Needs


@dataclass(frozen=True)
class Oracle:
    """Truth at the radio's resolution: scatterers of one Rayleigh cell become their centroid."""

    name: ClassVar[str] = "oracle"
    needs_truth: ClassVar[bool] = True
    needs: ClassVar[Needs] = Needs(elements="none", integration=None, cells="none")

    def estimate(self, observation: Observation, truth: PointCloud | None = None) -> PointCloud:
        """Blur the truth to Rayleigh cells.

        Parameters
        ----------
        observation : Observation
            Only its system, array and frame are used.
        truth : PointCloud

        Returns
        -------
        PointCloud
            Centroids in x, y, z and v; the powers of a cell are summed.

        Raises
        ------
        InputError
            Without a truth.
        """
        if truth is None:
            raise InputError("estimator oracle needs the truth: call estimate(observation, scenario.truth)")
        system, (n_p, n_q) = observation.system, observation.array.shape
        offset_m = truth.xyz - observation.base_station_m
        u, w = observation.frame.direction_cosines(offset_m)
        range_m = np.linalg.norm(offset_m, axis=1)
        coordinates = np.column_stack([range_m, truth.velocity, u, w])
        cell_size = np.array([system.range_bin_m, system.velocity_bin_mps, 2 / n_p, 2 / n_q])
        _, cell, count = np.unique(
            np.floor(coordinates / cell_size), axis=0, return_inverse=True, return_counts=True
        )
        sums = np.zeros((count.size, 5))
        np.add.at(sums, cell.ravel(), truth.to_array())
        sums[:, :4] /= count[:, None]
        return PointCloud.from_array(sums)
