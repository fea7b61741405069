"""Sparse Bayesian learning: powers of dictionary atoms and of Doppler lines that make data most likely.

Data y are echoes of unknown complex amplitudes of power g in noise of covariance N:

    C = A diag(g) A^T + N.

A and N are real here, y is complex. The likelihood is raised by

    g <- g |q| / sqrt(s),    q = A^T C^-1 y,  s = diag(A^T C^-1 A),

whose fixed points are those of expectation maximisation, found in about a
dozen steps instead of hundreds. Most powers tend to 0: the result is sparse
without a penalty to choose. The amplitudes are g q, the posterior means.

All elements of the array are snapshots of one spectrum. A bin of the discrete
transform mixes neighbouring speeds; the learned powers do not, and filters made
of them pass an echo of one speed and suppress all others (Capon's filter with a
modelled covariance).

References
----------
Tipping, "Sparse Bayesian learning and the relevance vector machine", J. Machine
Learning Research 1 (2001).
Wipf and Rao, "An empirical Bayesian strategy for solving the simultaneous sparse
approximation problem", IEEE Trans. SP 55 (2007).
Stoica and Babu, "SPICE and LIKES: two hyperparameter-free methods for sparse-
parameter estimation", Signal Processing 92 (2012): the update with the root.
Wipf and Rao, IEEE Trans. SP 55 (2007): many snapshots share their powers.
Capon, "High-resolution frequency-wavenumber spectrum analysis", Proc. IEEE 57
(1969).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from isacbench.checked_arrays import Complex, Floats, Integers, Mask
from isacbench.dsp.positive_matrices import root_of_inverse, roots_of_inverses

LEAST_INFORMATION = 1e-30
"""Least s = a^T C^-1 a: an atom that the data do not see keeps a finite power, which is 0 soon."""

LEAST_SEEN = 1e-12
"""The same relative to the noise in a fit of atoms."""

ROUNDING = 1e-12
"""Least noise over the covariance of echoes: of cells that are no directions powers grow until rounding."""

STEPS_A_VARIANCE = 2
"""Steps that share one s: it changes slowly, and takes the inverse of C, where q takes a solution."""

PRUNED_DB = 45.0
"""Amplitudes so far below the strongest are left out of the steps that follow."""

FIRST_PRUNED_STEP = 2
"""Step from which atoms are left out: the first steps level powers that the first guess spread."""

FIRST_SHARE = 0.1
"""First powers, over those of a matched filter, which counts each echo on many places."""

LEAST_SHARE = 1e-12
"""Least first power over the largest, so that no place is ruled out at the start, and least noise over the
covariance, so that it can be inverted."""


class Noise(NamedTuple):
    """Covariance of noise in data with axes (r, d, w): a Kronecker product, white along the last axis.

    Attributes
    ----------
    along_range : ndarray of float64, shape (r, r)
    along_doppler : ndarray of float64, shape (d, d)
    """

    power: float
    along_range: Floats
    along_doppler: Floats


Dictionaries = tuple[Floats, Floats, Floats]
"""Factors of atoms along three axes of data (r, d, w): (a, r), (b, d) and (c, w)."""


def matched(dictionaries: Dictionaries, data: Complex) -> Complex:
    """Compute the products of all atoms of a Kronecker dictionary with data.

    Parameters
    ----------
    dictionaries : (ndarray, ndarray, ndarray)
        Shapes (a, r), (b, d) and (c, w).
    data : ndarray of complex, shape (r, d, w)

    Returns
    -------
    ndarray of complex, shape (a, b, c)
    """
    along_range, along_doppler, along_direction = dictionaries
    r, d, w = data.shape
    rows = (along_range @ data.reshape(r, d * w)).reshape(-1, d, w)
    products: Complex = (along_doppler @ rows).reshape(-1, w) @ along_direction.T
    return products.reshape(len(along_range), len(along_doppler), len(along_direction))


class _Pairs(NamedTuple):
    """Products of the components of dictionary atoms, each pair (i, j) of dimensions once.

    Attributes
    ----------
    values : ndarray, shape (n_atoms, n_pairs)
        a_i a_j for i >= j.
    first, second : ndarray of int64, shape (n_pairs,)
        i and j.
    """

    values: Floats
    first: Integers
    second: Integers

    @classmethod
    def of(cls, dictionary: Floats) -> _Pairs:
        first, second = np.tril_indices(dictionary.shape[1])
        return cls(dictionary[:, first] * dictionary[:, second], first, second)

    @property
    def numbers(self) -> Integers:
        """Number of the pair of any two dimensions (n, n)."""
        n = int(self.first.max()) + 1
        numbers = np.empty((n, n), dtype=np.int64)
        numbers[self.first, self.second] = numbers[self.second, self.first] = np.arange(self.first.size)
        return numbers

    @property
    def is_square(self) -> Mask:
        return np.equal(self.first, self.second)


class GridModel:
    """Covariance of data whose atoms form a grid: C of all its atoms, and a^T C^-1 a of each.

    Each factor of an atom's covariance a a^T is symmetric, so that half of each
    is enough; products then take an eighth of the operations.

    Parameters
    ----------
    dictionaries : (ndarray, ndarray, ndarray)
        Shapes (a, r), (b, d) and (c, w).
    """

    def __init__(self, dictionaries: Dictionaries, noise: Noise) -> None:
        self._range, self._doppler, self._direction = pairs = [_Pairs.of(each) for each in dictionaries]
        self._n_atoms = tuple(len(each) for each in dictionaries)
        self._n_pairs = tuple(each.first.size for each in pairs)
        shape = r, d, w = tuple(each.shape[1] for each in dictionaries)
        self._shape, self._size = shape, r * d * w
        by_range, by_doppler, by_direction = (each.numbers for each in pairs)
        position = by_range[:, None, None, :, None, None] * self._n_pairs[1]
        position = position + by_doppler[None, :, None, None, :, None]
        position = position * self._n_pairs[2] + by_direction[None, None, :, None, None, :]
        self._position = position.reshape(self._size, self._size)
        along_range = noise.along_range[self._range.first, self._range.second]
        along_doppler = noise.along_doppler[self._doppler.first, self._doppler.second]
        white = self._direction.is_square
        self._noise = np.multiply.outer(np.multiply.outer(noise.power * along_range, along_doppler), white)

    def covariance(self, power: Floats) -> Floats:
        """Covariance of the data.

        Parameters
        ----------
        power : ndarray, shape (a, b, c)
            Of the atoms.

        Returns
        -------
        ndarray, shape (r d w, r d w)
        """
        (a, b, c), (_, n_doppler, n_direction) = self._n_atoms, self._n_pairs
        along = (power.reshape(a * b, c) @ self._direction.values).reshape(a, b, n_direction)
        along = self._doppler.values.T @ along
        pairs = self._range.values.T @ along.reshape(a, n_doppler * n_direction)
        return np.take(pairs.ravel() + self._noise.ravel(), self._position)

    def information(self, inverse: Floats) -> Floats:
        """Compute a^T C^-1 a of all atoms.

        Parameters
        ----------
        inverse : ndarray, shape (r d w, r d w)
            C^-1, symmetric.

        Returns
        -------
        ndarray, shape (a, b, c)
        """
        r, d, w = self._shape
        a, b, c = self._n_atoms
        n_range, n_doppler, n_direction = self._n_pairs
        folded = inverse.reshape(r, d, w, r, d, w)[self._range.first, :, :, self._range.second]
        folded = folded + folded.transpose(0, 3, 4, 1, 2)
        folded *= _once(self._range)[:, None, None, None, None]
        # Symmetric under exchange of both remaining pairs: the last fold is a factor of 2.
        by_doppler = folded[:, self._doppler.first, :, self._doppler.second].transpose(1, 0, 2, 3)
        by_doppler = by_doppler + by_doppler.transpose(0, 1, 3, 2)
        by_doppler *= _once(self._doppler)[:, None, None]
        pairs = by_doppler[:, :, self._direction.first, self._direction.second]
        pairs *= 2 * _once(self._direction)
        along = (self._range.values @ pairs.reshape(n_range, -1)).reshape(a, n_doppler, n_direction)
        information: Floats = (self._doppler.values @ along).reshape(a * b, -1) @ self._direction.values.T
        return information.reshape(a, b, c)


def _once(pairs: _Pairs) -> Floats:
    """Weights that count the square of a dimension once where a sum over both orders counts it twice."""
    return np.where(pairs.is_square, 0.5, 1.0)


def learn_grid(
    dictionaries: Dictionaries, data: Complex, noise: Noise, first_power: Floats, n_steps: int
) -> Complex:
    """Learn the amplitudes (a, b, c) of atoms on a grid of three axes: posterior means.

    Dictionaries have the shapes (a, r), (b, d) and (c, w), data (r, d, w). An atom whose first guess of its
    power is 0 keeps it. In double precision: in single precision the last digits, which differ from processor
    to processor, would decide about centroids of the atoms. With noise of power 0 NumPy's LinAlgError is
    raised.
    """
    along_range, along_doppler, along_direction = (np.ascontiguousarray(each) for each in dictionaries)
    dictionaries = along_range, along_doppler, along_direction
    # In a unit near the data's own, so that the least information means the same.
    unit = float(np.sqrt(np.mean(data.real**2 + data.imag**2)))
    data, power = data / unit, first_power / unit / unit
    model = GridModel(dictionaries, noise._replace(power=noise.power / unit / unit))
    target = np.stack([data.real.ravel(), data.imag.ravel()], axis=1)
    for step in range(n_steps):
        (root,) = roots_of_inverses(model.covariance(power)[None])
        solution = root @ (root.T @ target)
        seen = matched(dictionaries, (solution @ np.array([1, 1j])).reshape(data.shape))
        amplitude = power * seen
        if step % STEPS_A_VARIANCE == 0:
            information = model.information(root @ root.T)
        power = np.abs(amplitude) / np.sqrt(np.maximum(information, LEAST_INFORMATION))
    return unit * amplitude


def learn_directions(
    dictionaries: tuple[Floats, Floats], cells: Complex, noise: Floats, n_steps: int
) -> Floats:
    """Learn the powers (n, b, c) of directions in cells (n, n_u, n_w), each by itself.

    Dictionaries are steering vectors along u, (b, n_u), and w, (c, n_w); noise powers have the shape (n,).
    """
    along_u, along_w = dictionaries
    n, n_u, n_w = cells.shape
    squares_u, squares_w = (_outer(each) for each in dictionaries)
    power: Floats = 0.1 * np.abs(along_u @ cells @ along_w.T) ** 2
    loading = noise[:, None, None] * np.eye(n_u * n_w)
    target = cells.reshape(n, -1, 1)
    for _ in range(n_steps):
        covariance = (squares_u.T @ (power @ squares_w)).reshape(n, n_u, n_u, n_w, n_w)
        covariance = covariance.transpose(0, 1, 3, 2, 4).reshape(n, n_u * n_w, n_u * n_w)
        rounding = ROUNDING * np.trace(covariance, axis1=1, axis2=2)[:, None, None] * np.eye(n_u * n_w)
        inverse = np.linalg.inv(covariance + np.maximum(loading, rounding))
        seen = along_u @ (inverse @ target).reshape(n, n_u, n_w) @ along_w.T
        pairs = inverse.reshape(n, n_u, n_w, n_u, n_w).transpose(0, 1, 3, 2, 4)
        information = squares_u @ pairs.reshape(n, n_u**2, n_w**2) @ squares_w.T
        power = power * np.abs(seen) / np.sqrt(np.maximum(information, LEAST_INFORMATION))
    return power


def _outer(dictionary: Floats) -> Floats:
    """All products of two components of each atom, (n_atoms, n²)."""
    return (dictionary[:, :, None] * dictionary[:, None, :]).reshape(len(dictionary), -1)


def learn_atoms(
    gram: Floats, products: Complex, first_power: Floats, noise: float, n_steps: int
) -> tuple[Integers, Complex]:
    """Learn the amplitudes of atoms at any places, from their products.

    In the space of the atoms C^-1 becomes the inverse of I + D G D / N, with D the roots of the powers, G the
    Gram matrix (n, n) and N the noise power: as large as there are atoms, however large the data. `products`
    (n,) are those of the atoms with the data, and first powers are above 0.

    Returned are the indices (m,) of the atoms that are left (`PRUNED_DB`), and their amplitudes (m,),
    posterior means.
    """
    index, power = np.arange(len(gram)), first_power
    for step in range(n_steps):
        root = np.sqrt(power)
        system = gram * (root[:, None] * root / noise)
        system[np.diag_indices(len(system))] += 1
        inverse_root = root_of_inverse(system, 1.0)
        target = (root * products / noise).view(np.float64).reshape(-1, 2)
        solution = inverse_root @ (inverse_root.T @ target)
        amplitude = root * (solution @ np.array([1, 1j]))
        # Of the noise's 1 the data leave the inverse: the rest is what they tell of the atom, g s.
        data_share = np.maximum(1 - np.vecdot(inverse_root, inverse_root), LEAST_SEEN)
        power = np.abs(amplitude) * np.sqrt(power / data_share)
        size = np.abs(amplitude)
        stays = size > size.max() * 10 ** (-PRUNED_DB / 20)
        if FIRST_PRUNED_STEP <= step < n_steps - 1 and not stays.all():
            index, gram, products = index[stays], gram[np.ix_(stays, stays)], products[stays]
            power, amplitude = power[stays], amplitude[stays]
    return index, amplitude


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

    Rows (n_range, n_doppler, n_elements) are such that Doppler lines are real (`AtomMap`). Lines at Doppler
    bins (v,) have the echoes `kernels` (v, n_doppler). Noise powers (n_range,) are above 0.
    """
    _, n_doppler, n_elements = rows.shape
    parts = np.ascontiguousarray(rows).view(np.float64)
    sample = parts @ parts.transpose(0, 2, 1) / n_elements
    # Products of two bins, each pair once: a matrix product takes the quadratic forms of all lines.
    of_bins = _Pairs.of(kernels)
    pairs, first, second = of_bins
    full, count = of_bins.numbers, np.where(of_bins.is_square, 1, 2)
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
