"""Beamformers of a planar array: Bartlett's, Capon's and the iterative adaptive approach.

Snapshots become real by the unitary transform of both axes, and steering
vectors referred to the middle of the array become real vectors: a complex
snapshot is two real ones, its real and its imaginary part.

References
----------
Bartlett, "Smoothing periodograms from time-series with continuous spectra",
Nature 161 (1948).
Capon, "High-resolution frequency-wavenumber spectrum analysis", Proc. IEEE 57
(1969).
Carlson, "Covariance matrix estimation errors and diagonal loading in adaptive
arrays", IEEE Trans. AES 24 (1988).
Yardibi, Li, Stoica, Xue and Baggeroer, "Source localization and sensing: a
nonparametric iterative adaptive approach based on weighted least squares",
IEEE Trans. AES 46 (2010).
"""

from __future__ import annotations

import numpy as np

from isacbench.checked_arrays import Complex, Floats, checked_array, parts_of
from isacbench.dsp.angles.line_subspaces import real_steering, unitary_transform
from isacbench.dsp.angles.planar_spectra import (
    AngularSpectrum,
    BeamformerSpectrum,
    descended_minima,
    projections,
    squared_projections,
)
from isacbench.dsp.angles.planar_subspaces import CHUNK_VALUES, planar_covariance
from isacbench.dsp.angles.plane_waves import PlaneWaves
from isacbench.dsp.positive_matrices import roots_of_inverses

LEAST_NOISE = 16 * float(np.finfo(np.float64).eps)
"""Noise relative to the trace of a modelled covariance, below which it is lost in rounding."""

LEAST_LOADING = 1e-12
"""Loading relative to the mean eigenvalue: without noise, covariances of few waves are singular."""

NEGLIGIBLE = 1e-4
"""Singular value, relative to the largest, below which a dimension of steering vectors is left out."""


def bartlett_spectrum(snapshots: Complex, u: Floats, w: Floats) -> BeamformerSpectrum:
    """Power |a^H x|² / (P Q)² of beams steered to a grid of directions.

    Parameters
    ----------
    snapshots : ndarray of complex, shape (n, P, Q)
    u, w : ndarray of float64, shapes (g,) and (h,)

    Returns
    -------
    BeamformerSpectrum
        In noise of power σ² its mean is σ² / (P Q); of a unit wave it is 1.
    """
    columns = real_columns(snapshots)
    power = squared_projections(columns, u, w) / (snapshots.shape[1] * snapshots.shape[2]) ** 2
    return BeamformerSpectrum(u, w, power, columns, reciprocal=False)


def strongest_direction(snapshots: Complex, u: Floats, w: Floats) -> PlaneWaves:
    """Find one plane wave a cell: the maximum of Bartlett's spectrum next to a start, by Newton's method.

    It is the most likely direction of a wave that is alone in its cell.

    Parameters
    ----------
    snapshots : ndarray of complex, shape (n, P, Q)
    u, w : ndarray of float64, shape (n,)
        Starts, which it is at most half a Rayleigh cell away from.
    """
    n, *shape = snapshots.shape
    places, *_ = descended_minima(
        real_columns(snapshots), np.arange(n), np.stack([u, w], axis=1), 1 / np.array(shape), -1
    )
    return PlaneWaves(places[:, :1], places[:, 1:], np.ones((n, 1), dtype=np.bool_))


def capon_spectrum(
    snapshots: Complex, subarray: tuple[int, int], loading: float, u: Floats, w: Floats
) -> BeamformerSpectrum:
    """Power 1 / (a^H R^-1 a) behind the filters that pass a direction and least of all else (MVDR).

    Snapshots have the shape (n, P, Q). R is smoothed over subarrays of L, M elements, forwards and backwards,
    and `loading` is added to its diagonal. In white noise of power σ² (loading included) the spectrum is σ² /
    (L M).
    """
    n_sensors = subarray[0] * subarray[1]
    columns = np.empty((len(snapshots), *subarray, n_sensors))
    for some in parts_of(len(snapshots), CHUNK_VALUES // n_sensors**2):
        covariance = planar_covariance(snapshots[some, None], subarray)
        diagonal = np.einsum("nii->ni", covariance)
        mean = diagonal.mean(axis=1, keepdims=True)
        # A cell without any power has no spectrum; 1 in place of 0 keeps its matrix regular.
        diagonal += np.where(mean > 0, loading + LEAST_LOADING * mean, 1)
        columns[some] = roots_of_inverses(covariance).reshape(-1, *subarray, n_sensors)
    return BeamformerSpectrum(u, w, 1 / squared_projections(columns, u, w), columns, reciprocal=True)


def iaa_spectrum(
    snapshots: Complex, noise: float, n_iterations: int, u: Floats, w: Floats
) -> AngularSpectrum:
    """Power by the iterative adaptive approach, from one snapshot (n, P, Q) a cell.

    Starting from Bartlett's spectrum P, each iteration models the covariance, R = Σ P a a^H + σ² I over all
    directions of the grid, and estimates P anew, |a^H R^-1 x|² / (a^H R^-1 a)². The published R has no σ² I:
    the known noise, above 0, keeps it regular where few directions have power.

    Snapshots are read in the dimensions that the steering vectors of the grid span (`NEGLIGIBLE`): noise in
    the others tells nothing about P. As R is a sum over a grid, it and all quadratic forms with its inverse
    are products of matrices along u and along w.
    """
    a, into_u = _spanned(real_steering(snapshots.shape[1], u))
    b, into_w = _spanned(real_steering(snapshots.shape[2], w))
    columns = np.einsum("npqs,pi,qj->nijs", real_columns(snapshots), into_u, into_w, optimize=True)
    power = np.empty((len(snapshots), u.size, w.size))
    for some in parts_of(len(snapshots), CHUNK_VALUES // (len(a) * len(b)) ** 2):
        beams = projections(columns[some], a, b)
        power[some] = np.vecdot(beams, beams) / (snapshots.shape[1] * snapshots.shape[2]) ** 2
        for _ in range(n_iterations):
            power[some] = _adapted_power(power[some], columns[some], a, b, noise)
    return AngularSpectrum(u, w, power)


def _adapted_power(power: Floats, columns: Floats, a: Floats, b: Floats, noise: float) -> Floats:
    """One iteration (n, g, h) from the power of the one before."""
    (n_u, n_g), (n_w, n_h), n = a.shape, b.shape, len(power)
    n_sensors = n_u * n_w
    # Products of the entries of a steering vector, one column a direction.
    aa = (a[:, None] * a).reshape(n_u * n_u, n_g)
    bb = (b[:, None] * b).reshape(n_w * n_w, n_h)
    model = (aa @ power @ bb.T).reshape(n, n_u, n_u, n_w, n_w).transpose(0, 1, 3, 2, 4)
    model = model.reshape(n, n_sensors, n_sensors)
    diagonal = np.einsum("nii->ni", model)
    diagonal += np.maximum(noise, LEAST_NOISE * diagonal.sum(axis=1, keepdims=True))
    # R^-1 = W W^T, and a^T R^-1 x = (W^T a)^T (W^T x).
    roots = roots_of_inverses(model)
    whitened = roots.transpose(0, 2, 1) @ columns.reshape(n, n_sensors, -1)
    beams = projections(roots.reshape(n, n_u, n_w, n_sensors), a, b)
    output = beams.reshape(n, n_g * n_h, n_sensors) @ whitened
    return np.sum(output**2, axis=2).reshape(n, n_g, n_h) / np.vecdot(beams, beams) ** 2


def _spanned(steering: Floats) -> tuple[Floats, Floats]:
    """Steering vectors (d, g) in the dimensions that they span, and the basis (L, d) of those."""
    directions, strength, _ = np.linalg.svd(steering, full_matrices=False)
    basis: Floats = directions[:, strength > NEGLIGIBLE * strength[0]]
    return basis.T @ steering, basis


def real_columns(snapshots: Complex) -> Floats:
    """Real and imaginary parts (n, P, Q, 2) of complex snapshots (n, P, Q), after the unitary transform."""
    into_u, into_w = (unitary_transform(n).conj() for n in snapshots.shape[1:])
    turned = into_u.T @ checked_array("snapshots", snapshots, np.complex128) @ into_w
    return np.stack([turned.real, turned.imag], axis=-1)
