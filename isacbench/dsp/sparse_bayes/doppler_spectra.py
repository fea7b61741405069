"""Doppler spectra of range bins by sparse Bayesian learning, and filters that pass one Doppler line.

All elements of the array are snapshots of one spectrum. A bin of the discrete
transform mixes neighbouring speeds; the learned powers do not, and filters made
of them pass an echo of one speed and suppress all others (Capon's filter with a
modelled covariance).

References
----------
Tipping, "Sparse Bayesian learning and the relevance vector machine", J. Machine
Learning Research 1 (2001).
Wipf and Rao, IEEE Trans. SP 55 (2007): many snapshots share their powers.
Capon, "High-resolution frequency-wavenumber spectrum analysis", Proc. IEEE 57
(1969).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from isacbench.checked_arrays import Complex, Floats, Mask

FIRST_SHARE = 0.1
"""First powers, over those of a matched filter, which counts each echo on many places."""

LEAST_SHARE = 1e-12
"""Least first power over the largest, so that no place is ruled out at the start, and least noise over the
covariance, so that it can be inverted."""

LEAST_INFORMATION = 1e-30
"""Least d^T C^-1 d of a line d."""


@dataclass(frozen=True, eq=False)
class DopplerSpectra:
    """Powers of Doppler lines in range bins.

    Attributes
    ----------
    doppler_bins : ndarray of float64, shape (v,)
        Places of the lines, finer than a bin.
    kernels : ndarray of float64, shape (v, n_doppler)
        Echoes of the lines in the Doppler bins of the map.
    power : ndarray of float64, shape (n_range, v)
    noise : ndarray of float64, shape (n_range,)
        Power that the spectra were learned with.
    """

    doppler_bins: Floats
    kernels: Floats
    power: Floats
    noise: Floats

    def filters(self, line: Floats, interfering: Mask) -> Floats:
        """Filters that pass a line and least of interfering ones and noise.

        Parameters
        ----------
        line : ndarray of float64, shape (n_doppler,)
            Echo of the line.
        interfering : ndarray of bool, shape (v,)
            Lines to suppress.

        Returns
        -------
        ndarray of float64, shape (n_range, n_doppler)
            Weights with w^T d = 1.
        """
        kernels = self.kernels[interfering]
        covariance = (self.power[:, None, interfering] * kernels.T) @ kernels
        covariance += _loading(covariance, self.noise)[:, None, None] * np.eye(line.size)
        weights = np.linalg.solve(covariance, np.broadcast_to(line[:, None], (len(covariance), line.size, 1)))
        return weights[..., 0] / (weights[..., 0] @ line)[:, None]


def learn_doppler_spectra(
    rows: Complex, doppler_bins: Floats, kernels: Floats, noise: Floats, n_steps: int
) -> DopplerSpectra:
    """Learn the Doppler spectrum of each range bin.

    Parameters
    ----------
    rows : ndarray of complex128, shape (n_range, n_doppler, n_elements)
        In which Doppler lines are real (`AtomMap`).
    doppler_bins : ndarray of float64, shape (v,)
        Places of the lines.
    kernels : ndarray of float64, shape (v, n_doppler)
        Echoes of the lines.
    noise : ndarray of float64, shape (n_range,)
        Noise powers, above 0.
    """
    _, n_doppler, n_elements = rows.shape
    parts = np.ascontiguousarray(rows).view(np.float64)
    sample = parts @ parts.transpose(0, 2, 1) / n_elements
    # Products of two bins, each pair once: a matrix product takes the quadratic forms of all lines.
    first, second = np.tril_indices(n_doppler)
    pairs = kernels[:, first] * kernels[:, second]
    full = np.empty((n_doppler, n_doppler), dtype=np.int64)
    full[first, second] = full[second, first] = np.arange(first.size)
    count = np.where(first == second, 1, 2)
    energy = np.sum(kernels**2, axis=1)
    power = FIRST_SHARE * (sample[:, first, second] * count) @ pairs.T / energy**2
    power += LEAST_SHARE * power.max()
    diagonal = np.arange(n_doppler)
    for _ in range(n_steps):
        covariance = (power @ pairs)[:, full]
        covariance[:, diagonal, diagonal] += _loading(covariance, noise)[:, None]
        inverse = np.linalg.inv(covariance)
        seen = ((inverse @ sample @ inverse)[:, first, second] * count) @ pairs.T
        information = (inverse[:, first, second] * count) @ pairs.T
        power = power * np.sqrt(np.maximum(seen, 0) / np.maximum(information, LEAST_INFORMATION))
    return DopplerSpectra(doppler_bins, kernels, power, noise)


def _loading(covariance: Floats, noise: Floats) -> Floats:
    """Noise, but not below rounding: of data that are no lines powers grow without a bound."""
    return np.maximum(noise, LEAST_SHARE * covariance.diagonal(axis1=1, axis2=2).max(axis=1))
