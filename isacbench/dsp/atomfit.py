"""Joint fits of many atoms to a map: amplitudes, Newton steps of all places together, and their accuracy.

Amplitudes are linear and are eliminated (variable projection), so that a step
solves for four real coordinates an atom. The matrix of the step is, up to the
noise, the joint Fisher information, whose inverse is the Cramér-Rao bound.

References
----------
Golub and Pereyra, "The differentiation of pseudo-inverses and nonlinear least
squares problems whose variables separate", SIAM J. Numer. Anal. 10 (1973).
Kaufman, "A variable projection method for solving separable nonlinear least
squares problems", BIT 15 (1975).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isacbench.dsp.atoms import N_COORDINATES, AtomMap, Correlations, Lines, product_matrix

__all__ = ["AtomFit", "fit_atoms", "refine_atoms", "refit_atoms"]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

LOADING = 1e-10
"""Of Gram matrices of unit atoms: two that coincide share their amplitude."""

FIRST_DAMPING, LEAST_DAMPING = 1e-3, 1e-6
"""Levenberg-Marquardt damping, relative to the diagonal of the information."""

LONGEST_STEP_CELLS = 0.3
"""Beyond it the quadratic model of a kernel is wrong."""


@dataclass(frozen=True, eq=False)
class AtomFit:
    """Least-squares fit of n atoms at given places.

    Attributes
    ----------
    places : ndarray of float64, shape (n, 4)
        In Rayleigh cells.
    amplitude : ndarray of complex128, shape (n,)
        Of the unit-energy atoms; a scatterer's power per element of the map
        is |amplitude|² / (P Q).
    energy : float
        Explained of the map's.
    score : ndarray of float64, shape (4 n,)
        Half the slope of the energy along all coordinates, coordinate by
        coordinate.
    information : ndarray of float64, shape (4 n, 4 n)
        Of the places, amplitudes eliminated, for noise of power 2 per cell
        and element.
    correlations : Correlations
        Of the atoms with the map.
    """

    places: Floats
    amplitude: Complex
    energy: float
    score: Floats
    information: Floats
    correlations: Correlations

    def __len__(self) -> int:
        return self.amplitude.size

    @property
    def power(self) -> Floats:
        """Energies |amplitude|² of the atoms, shape (n,)."""
        power: Floats = self.amplitude.real**2 + self.amplitude.imag**2
        return power

    def covariance(self, noise: float) -> Floats:
        """Joint Cramér-Rao bound of the places (4, n, 4, n) in noise of a power, Rayleigh cells squared."""
        n = len(self)
        loaded = self.information + LOADING * np.diag(self.information.diagonal())
        bound: Floats = noise / 2 * np.asarray(np.linalg.inv(loaded), dtype=np.float64)
        return bound.reshape(N_COORDINATES, n, N_COORDINATES, n)


def fit_atoms(atom_map: AtomMap, places: Floats) -> AtomFit:
    """Fit the amplitudes of atoms, and prepare a step of their places.

    Parameters
    ----------
    atom_map : AtomMap
    places : ndarray of float64, shape (n, 4)
        In Rayleigh cells, n at least 1.

    Returns
    -------
    AtomFit
    """
    lines = atom_map.lines(places)
    return _fit(atom_map, places, lines, atom_map.correlate(lines))


def refit_atoms(atom_map: AtomMap, fit: AtomFit, keep: NDArray[np.bool_], places: Floats) -> AtomFit:
    """Fit some of the atoms of another fit; only atoms that have moved are correlated anew.

    Parameters
    ----------
    atom_map : AtomMap
    fit : AtomFit
        Of n atoms.
    keep : ndarray of bool, shape (n,)
        Atoms that stay, one at least.
    places : ndarray of float64, shape (n, 4)
        Where they are now.

    Returns
    -------
    AtomFit
    """
    known = fit.correlations.select(keep)
    moved = np.any(places[keep] != fit.places[keep], axis=1)
    if moved.any():
        fresh = atom_map.correlate(atom_map.lines(places[keep][moved]))
        known.value[moved], known.slope[moved] = fresh.value, fresh.slope
    return _fit(atom_map, places[keep], atom_map.lines(places[keep]), known)


def _fit(atom_map: AtomMap, places: Floats, lines: Lines, correlations: Correlations) -> AtomFit:
    n = len(places)
    products = atom_map.products(lines)
    gram = product_matrix(products, None, None) + LOADING * np.eye(n)
    mixed = np.concatenate([product_matrix(products, None, axis) for axis in range(N_COORDINATES)], axis=1)
    slopes = np.block(
        [
            [product_matrix(products, left, right) for right in range(N_COORDINATES)]
            for left in range(N_COORDINATES)
        ]
    )
    target = np.stack([correlations.value.real, correlations.value.imag], axis=1)
    solved = np.linalg.solve(gram, np.concatenate([target, mixed], axis=1))
    amplitude = solved[:, 0] + 1j * solved[:, 1]
    residual_slope = correlations.slope.T.ravel() - mixed.T @ amplitude
    tiled = np.tile(amplitude, N_COORDINATES)
    coherence = (amplitude.conj()[:, None] * amplitude).real
    return AtomFit(
        places,
        amplitude,
        float((correlations.value.conj() @ amplitude).real),
        (tiled.conj() * residual_slope).real,
        (slopes - mixed.T @ solved[:, 2:]) * np.tile(coherence, (N_COORDINATES, N_COORDINATES)),
        correlations,
    )


def refine_atoms(atom_map: AtomMap, places: Floats, n_steps: int) -> AtomFit:
    """Move all atoms together towards the least-squares fit of the map (Levenberg-Marquardt).

    Parameters
    ----------
    atom_map : AtomMap
    places : ndarray of float64, shape (n, 4)
        In Rayleigh cells, n at least 1.
    n_steps : int
        Steps to try; one that explains less is taken back.

    Returns
    -------
    AtomFit
        The best one seen.
    """
    best = fit_atoms(atom_map, places)
    damping = FIRST_DAMPING
    for _ in range(n_steps):
        tried = fit_atoms(atom_map, best.places + _step(best, damping))
        if tried.energy >= best.energy:
            best, damping = tried, max(damping / 3, LEAST_DAMPING)
        else:
            damping *= 10
    return best


def _step(fit: AtomFit, damping: float) -> Floats:
    """Damped Gauss-Newton step (n, 4), no atom farther than the kernels are known."""
    diagonal = fit.information.diagonal()
    load = damping * diagonal + np.finfo(np.float64).eps * diagonal.max()
    step = np.linalg.solve(fit.information + np.diag(load), fit.score).reshape(N_COORDINATES, -1).T
    longest = np.abs(step).max(axis=1, keepdims=True)
    limited: Floats = step * (LONGEST_STEP_CELLS / np.maximum(longest, LONGEST_STEP_CELLS))
    return limited
