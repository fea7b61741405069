"""Joint fits of many atoms to a map: amplitudes, Newton steps of all places together, and their accuracy.

Amplitudes are linear and are eliminated (variable projection), so that a step
solves for four real coordinates an atom. The matrix of the step is, up to the
noise, the joint Fisher information, whose inverse is the Cramér-Rao bound.

Products of atoms square the data: of two atoms d Rayleigh cells apart, d²
survives in the Gram matrix, and in the information d⁴ for echoes in phase, d²
for echoes in quadrature. Rounding leaves places known from about 0.01 cells in
phase and 0.001 in quadrature.

Only the right side of a step needs all digits, not its matrix. So a fit is
settled on its misfit to the map, cell by cell (`polish_atoms`): differences are
taken before anything is squared, and rounding is magnified by the condition of
the atoms and slopes, not by its square.

References
----------
Golub and Pereyra, "The differentiation of pseudo-inverses and nonlinear least
squares problems whose variables separate", SIAM J. Numer. Anal. 10 (1973).
Kaufman, "A variable projection method for solving separable nonlinear least
squares problems", BIT 15 (1975).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from isacbench.checked_arrays import Complex, Floats, Integers
from isacbench.dsp.fitting.atoms import (
    N_COORDINATES,
    AtomFactors,
    AtomMap,
    Correlations,
    LineProducts,
    Lines,
    product_matrix,
)
from isacbench.dsp.floating_point import round_step
from isacbench.dsp.positive_matrices import root_of_inverse, solve_positive

ROUNDING = 16 * float(np.finfo(np.float64).eps)
"""Error of the product of two unit atoms, which is one of four products along the coordinates."""

LEVERAGE = 4.0
"""Rounding of the information, of two products with a loading between them, over that of a product."""

LEAST_SLOPE = 1e-6
"""Least energy of a unit atom's slope along a coordinate: 3 of many samples, 0 of one sample."""

NOT_LESS = 1e-12
"""Of the explained energy: a step that loses no more may as well gain."""

LEAST_OWN = 1e-6
"""Least energy of a unit atom that others do not explain: 5e-4 cells from another, steps are rounding."""

FIRST_DAMPING, LEAST_DAMPING = 1e-3, 1e-12
"""Levenberg-Marquardt damping, relative to the diagonal of the information."""

LONGEST_STEP_CELLS = 0.3
"""Longest step: beyond it the quadratic model of a kernel is wrong."""

UNLIMITED = np.array(-np.inf), np.array(np.inf)
"""Limits of places that may be anywhere."""


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
        Energy of the map that the atoms explain.
    correlations : Correlations
        Of the atoms with the map.
    lines : tuple of AtomFactors
        Of the atoms (`AtomMap.lines`).
    gram : ndarray of float64, shape (n, n)
        Products of the atoms, loaded by the ridge of the fit and by their
        rounding, so that two atoms that coincide share their amplitude.
    atom_map : AtomMap
        That is fitted.
    """

    places: Floats
    amplitude: Complex
    energy: float
    correlations: Correlations
    lines: Lines
    gram: Floats
    atom_map: AtomMap

    def __len__(self) -> int:
        return self.amplitude.size

    @cached_property
    def products(self) -> tuple[LineProducts, ...]:
        """Products of the atoms with each other (`AtomMap.products`)."""
        return self.atom_map.products(self.lines)

    @property
    def power(self) -> Floats:
        """Energies |amplitude|² of the atoms, shape (n,)."""
        return self.amplitude.real**2 + self.amplitude.imag**2

    @property
    def shown_energy(self) -> Floats:
        """Energies of the atoms, but at most those of lone atoms that the map would show there, shape (n,).

        Two atoms that nearly cancel can have any energies, of which the map shows only their sum.
        """
        lone = self.correlations.value / self.gram.diagonal()
        return np.minimum(self.power, lone.real**2 + lone.imag**2)

    @property
    def own(self) -> Floats:
        """Energy of each unit atom that the other atoms do not explain, shape (n,)."""
        return 1 / np.maximum(np.vecdot(self._gram_root, self._gram_root), 1)

    @cached_property
    def score(self) -> Floats:
        """Half the slope of the energy along all coordinates, coordinate by coordinate, shape (4 n,)."""
        residual_slope = self.correlations.slope.T.ravel() - self._mixed.T @ self.amplitude
        return (np.tile(self.amplitude, N_COORDINATES).conj() * residual_slope).real

    @cached_property
    def information(self) -> Floats:
        """Fisher information of the places (4 n, 4 n), amplitudes eliminated, in noise of power 2."""
        information: Floats = self._slopes - self._explained.T @ self._explained
        coherence = (self.amplitude.conj()[:, None] * self.amplitude).real
        n = len(self)
        blocks = information.reshape(N_COORDINATES, n, N_COORDINATES, n)
        blocks *= coherence[:, None, :]
        return information

    @cached_property
    def rounding(self) -> Floats:
        """Error of the information's diagonal by rounding, shape (4 n,)."""
        # The elimination divides by the part of an atom that the others do not explain.
        slopes = np.maximum(self._slopes.diagonal(), LEAST_SLOPE)
        rounding: Floats = slopes * np.tile(self.power / self.own, N_COORDINATES)
        return LEVERAGE * ROUNDING * rounding

    def steps(self, rest: Correlations) -> tuple[Complex, Floats]:
        """Undamped Gauss-Newton steps of the amplitudes and of the places.

        Parameters
        ----------
        rest : Correlations
            Of the atoms with the map less their echoes.

        Returns
        -------
        amplitude : ndarray of complex128, shape (n,)
        places : ndarray of float64, shape (n, 4)
            In Rayleigh cells.
        """
        own = self._gram_root @ (self._gram_root.T @ rest.value)
        turning = np.tile(self.amplitude, N_COORDINATES)
        score = (turning.conj() * (rest.slope.T.ravel() - self._mixed.T @ own)).real
        along = self.bound_root @ (self.bound_root.T @ score)
        amplitude: Complex = own - self._gram_root @ (self._explained @ (turning * along))
        return amplitude, along.reshape(N_COORDINATES, -1).T

    def energy_of(self, atoms: Integers) -> float:
        """Energy that some atoms explain beside all others, less that of the ridge."""
        root, amplitude = self._gram_root[atoms], self.amplitude[atoms]
        return float((amplitude.conj() @ np.linalg.solve(root @ root.T, amplitude)).real)

    def lost_without(self) -> Floats:
        """Energy (n, n) not explained any more without an atom (row) if another (column) moves instead.

        To first order in the move; all amplitudes are fitted anew. On the diagonal no atom moves.
        """
        n, each, own = len(self), np.arange(len(self)), self.own
        explained = self._explained.reshape(n, N_COORDINATES, n)
        free = self._slopes.reshape(N_COORDINATES, n, N_COORDINATES, n)[:, each, :, each]
        free = free - np.einsum("kli,kri->ilr", explained, explained) + LEAST_SLOPE * np.eye(N_COORDINATES)
        # The atom that moves is the first axis from here on, the one that is missing the last.
        share = (self._gram_root @ self._explained).reshape(explained.shape).T
        by_moving = own * np.sum(share * np.linalg.solve(free, share), axis=1)
        by_amplitude = -own * (self._gram_root @ self._gram_root.T)
        by_moving[each, each] = by_amplitude[each, each] = 0
        merged = self.amplitude[:, None] + by_amplitude * self.amplitude
        energy = merged.real**2 + merged.imag**2
        turned = self.amplitude[:, None].conj() * self.amplitude
        # A move explains only what is in phase with the atom.
        left = np.minimum(turned.real**2 / (1 + by_moving) + turned.imag**2, self.power * energy)
        return (own * left / np.maximum(energy, np.finfo(np.float64).tiny)).T

    @cached_property
    def _mixed(self) -> Floats:
        """Products (n, 4 n) of the atoms with all slopes."""
        return np.concatenate(
            [product_matrix(self.products, None, axis) for axis in range(N_COORDINATES)], axis=1
        )

    @cached_property
    def _slopes(self) -> Floats:
        """Products (4 n, 4 n) of all slopes."""
        n = len(self)
        blocks = np.empty((N_COORDINATES, n, N_COORDINATES, n))
        for left, right in np.ndindex(N_COORDINATES, N_COORDINATES):
            blocks[left, :, right] = product_matrix(self.products, left, right)
        return blocks.reshape(N_COORDINATES * n, N_COORDINATES * n)

    @cached_property
    def _gram_root(self) -> Floats:
        """Root W (n, n) of the inverse W Wᵀ of the Gram matrix: sums of atoms orthonormal to each other."""
        return root_of_inverse(self.gram, ROUNDING)

    @cached_property
    def _explained(self) -> Floats:
        """Products (n, 4 n) of these sums with all slopes."""
        return self._gram_root.T @ self._mixed

    @cached_property
    def bound_root(self) -> Floats:
        """Root W (4 n, 4 n) of the places' Cramér-Rao bound W Wᵀ in noise of power 2.

        No variance is above that of an information of the size of its rounding.
        """
        # Unit diagonal: strong and weak atoms are rounded alike.
        scale = 1 / np.sqrt(np.maximum(self.information.diagonal(), self.rounding))
        loaded = self.information * scale[:, None] * scale
        loaded[np.diag_indices(len(loaded))] += self.rounding * scale**2
        return root_of_inverse(loaded, ROUNDING) * scale[:, None]


def fit_atoms(atom_map: AtomMap, places: Floats, ridge: float = 0.0, known: AtomFit | None = None) -> AtomFit:
    """Fit the amplitudes of atoms at places (n, 4) in Rayleigh cells; prepare a step of them.

    With a `ridge` above 0, the weight of the energies |amplitude|² against that of the misfit, atoms that
    nearly coincide share an amplitude instead of cancelling. The energy of the fit is what the atoms explain,
    less that of the ridge. Atoms that stand where another fit to the map has them, `known`, are not
    correlated with it anew.
    """
    lines = atom_map.lines(places)
    correlations = _correlations(atom_map, places, lines, known)
    gram: Floats = np.prod([line.value @ line.value.T for line in lines], axis=0)
    gram[np.diag_indices(len(gram))] += ROUNDING + ridge
    target = np.stack([correlations.value.real, correlations.value.imag], axis=1)
    amplitude: Complex = np.linalg.solve(gram, target) @ np.array([1, 1j])
    energy = float((correlations.value.conj() @ amplitude).real)
    return AtomFit(places, amplitude, energy, correlations, lines, gram, atom_map)


def _correlations(atom_map: AtomMap, places: Floats, lines: Lines, known: AtomFit | None) -> Correlations:
    """Products of atoms with the map, those in the same places taken from another fit."""
    if not known:
        return atom_map.correlate(lines)
    same = (places[:, None] == known.places).all(axis=2)
    fresh, index = ~same.any(axis=1), same.argmax(axis=1)
    value, slope = known.correlations.value[index], known.correlations.slope[index]
    if fresh.any():
        others = atom_map.correlate(tuple(AtomFactors(*(factor[fresh] for factor in line)) for line in lines))
        value[fresh], slope[fresh] = others.value, others.slope
    return Correlations(value, lambda: slope)


def refine_atoms(
    atom_map: AtomMap,
    places: Floats,
    n_steps: int,
    limits: tuple[Floats, Floats] = UNLIMITED,
    damping: float = FIRST_DAMPING,
    known: AtomFit | None = None,
    ridge: float = 0.0,
) -> AtomFit:
    """Move all atoms together towards the least-squares fit of the map (Levenberg-Marquardt).

    Places (n, 4) in Rayleigh cells keep the digits that a step determines
    (`isacbench.dsp.floating_point.round_step`). In a crowd steps never end, and each would magnify the last
    digits of the one before. A step that explains less, beyond rounding, or that leads atoms to one place, is
    taken back.

    `limits` are the lowest and highest places (n, 4) that a step may lead to. `damping` is that of the first
    step; less is better nearer to the optimum. `known` is another fit to the map, and `ridge` the weight of
    the atoms' energies (`fit_atoms`).
    """
    best = fit_atoms(atom_map, places, ridge, known)
    for _ in range(n_steps):
        step = _step(best, damping)
        tried = fit_atoms(atom_map, np.clip(round_step(best.places + step, step), *limits), ridge)
        # At the optimum rounding decides which of two explains more; it must not decide about a step.
        if tried.energy >= (1 - NOT_LESS) * best.energy and tried.own.min() > LEAST_OWN:
            best, damping = tried, max(damping / 10, LEAST_DAMPING)
        else:
            damping *= 10
    return best


def _step(fit: AtomFit, damping: float) -> Floats:
    """Damped Gauss-Newton step (n, 4), no atom farther than the kernels are known."""
    diagonal = fit.information.diagonal()
    load = damping * diagonal + np.finfo(np.float64).eps * diagonal.max()
    return loaded_step(fit, load, LONGEST_STEP_CELLS)


def loaded_step(fit: AtomFit, load: Floats, most_cells: float) -> Floats:
    """Gauss-Newton step (n, 4) with a load (4 n,) on the information, shortened along the line it leads."""
    step = solve_positive(fit.information + np.diag(load), fit.score).reshape(N_COORDINATES, -1).T
    longest = np.abs(step).max(axis=1, keepdims=True)
    return step * (most_cells / np.maximum(longest, most_cells))


def polish_atoms(atom_map: AtomMap, fit: AtomFit, n_steps: int) -> AtomFit:
    """Finish a fit on its misfit to the map, for atoms so close that products have lost their digits.

    Each step first subtracts all echoes from the map, and correlates the rest. One that leaves more, beyond
    rounding, is taken back and is the last.
    """
    rounding = ROUNDING * np.sqrt(atom_map.energy)
    rest = atom_map.without(fit.lines, fit.amplitude)
    for _ in range(n_steps):
        amplitude_step, place_step = fit.steps(rest.correlate(fit.lines))
        moved = fit_atoms(atom_map, fit.places + place_step)
        moved = replace(moved, amplitude=fit.amplitude + amplitude_step)
        left = atom_map.without(moved.lines, moved.amplitude)
        if np.sqrt(left.energy) > (1 + NOT_LESS) * np.sqrt(rest.energy) + rounding:
            break
        fit, rest = moved, left
    return fit
