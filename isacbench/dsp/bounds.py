"""Deterministic Cramér-Rao bound of range, velocity and direction cosines.

Data are the echoes of `isacbench.model.echo` on all sensed resource elements
and all virtual elements in white circular complex Gaussian noise of power σ²
each. Each scatterer has four unknown parameters (R, v, u, w) and an unknown
complex amplitude G, magnitude and phase. The carrier phase exp(-j4π f_c R/c),
which would tell the range to a fraction of the wavelength, is part of G and
tells nothing here.

An echo is a wave exp(jψ), ψ linear in the parameters. All inner products of
echoes and of their slopes are sums x^a exp(jxΔ) along one axis (a = 0, 1, 2),
multiplied over the axes: neither the grid nor the array is ever filled.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from isacbench.display import brief
from isacbench.dsp.array_types import Complex, Floats
from isacbench.errors import require
from isacbench.model.prs import resource_elements

if TYPE_CHECKING:
    from isacbench.choices import Sensing
    from isacbench.model.frame import Frame
    from isacbench.model.numerology import System


N_NUISANCE = 2
"""Unknowns of a scatterer besides its parameters: real and imaginary part of its amplitude."""

N_PARAMETERS = 4

NEGLIGIBLE = 1e-3
"""Share of a variance that may be lost to rounding before the variance counts as infinite."""


@dataclass(frozen=True, eq=False)
class Bound:
    """Smallest covariance that an unbiased estimator can have.

    Attributes
    ----------
    covariance : ndarray of float64, shape (..., 4, 4)
        Of (R, v, u, w) of each scatterer, in m, m/s and 1. A scatterer that
        cannot be told from others has infinite variances, and NaN elsewhere.
    """

    covariance: Floats

    __repr__ = brief

    @property
    def range_m(self) -> Floats:
        """Standard deviations (...) of the range."""
        return self._std(0)

    @property
    def velocity_mps(self) -> Floats:
        """Standard deviations (...) of the radial velocity."""
        return self._std(1)

    @property
    def u(self) -> Floats:
        """Standard deviations (...) of the direction cosine u."""
        return self._std(2)

    @property
    def w(self) -> Floats:
        """Standard deviations (...) of the direction cosine w."""
        return self._std(3)

    def _std(self, parameter: int) -> Floats:
        return np.sqrt(self.covariance[..., parameter, parameter])


@dataclass(frozen=True, eq=False)
class JointBound(Bound):
    """Bound of scatterers that are estimated together.

    Attributes
    ----------
    covariance : ndarray of float64, shape (K, 4, 4)
    joint_covariance : ndarray of float64, shape (K, 4, K, 4)
        With the covariances between scatterers, from which follow those of
        distances.
    """

    joint_covariance: Floats

    __repr__ = brief


def tone_std_bins(n: int, snr_post: ArrayLike) -> Floats:
    """Bound of the frequency of one tone of unknown amplitude and phase, in bins of its DFT.

    The closed form behind all four parameters on the full grid: bins are
    range bins, velocity bins, and Rayleigh cells 2/P and 2/Q in u and w.

    Parameters
    ----------
    n : int
        Samples along the axis, at least 2.
    snr_post : array_like
        Signal-to-noise ratio after the gain of all resource and array
        elements: N_c N_sym P Q |G|²/σ².

    Returns
    -------
    ndarray of float64
        sqrt(3 / (2π² snr_post (1 - 1/n²))).

    References
    ----------
    Rife and Boorstyn, "Single-tone parameter estimation from discrete-time
    observations", IEEE Trans. Inf. Theory 20 (1974).

    Examples
    --------
    >>> round(float(tone_std_bins(2048, 100.0)), 4)
    0.039
    """
    require(n >= 2, "n", n, "2 and more")
    snr_post = _positive(snr_post, "snr_post")
    return np.sqrt(3 / (2 * np.pi**2 * snr_post * (1 - n**-2)))


def single_bound(
    system: System, array_shape: tuple[int, int], snr: ArrayLike, sensing: Sensing = "all"
) -> Bound:
    """Bound of one scatterer alone, in closed form, for any place of the scatterer.

    The bound is the inverse of 2 SNR times the covariance of the phase slopes
    of the four parameters over all sensed elements. On the full grid it is
    diagonal, with the entries of `tone_std_bins`; the comb of the PRS couples
    range and velocity slightly.

    Parameters
    ----------
    system : System
    array_shape : (int, int)
        Virtual elements (P, Q), at least 2 each.
    snr : array_like, shape (...)
        |G|²/σ² per resource element and virtual element.
    sensing : {"all", "prs"}
        Resource elements that are used.

    Returns
    -------
    Bound
        Of the shape of `snr`.

    Raises
    ------
    InputError
        If the elements that are used do not determine all four parameters, or
        a ratio is not positive.

    Examples
    --------
    >>> from isacbench.model.numerology import System
    >>> bound = single_bound(System(), (16, 16), snr=1e-6)
    >>> round(float(bound.range_m), 4), round(float(bound.u), 4)
    (0.011, 0.0045)
    """
    snr = _positive(snr, "snr")
    aperture = _aperture(system, array_shape, sensing)
    # The centroid is the origin of the slopes, so that second moments are covariances.
    slopes = aperture.moments()[1:, 1:]
    unit_covariance = np.outer(aperture.units, aperture.units) * np.linalg.inv(2 * slopes)
    return Bound(unit_covariance / snr[..., None, None])


def joint_bound(
    system: System,
    array_shape: tuple[int, int],
    range_m: ArrayLike,
    velocity_mps: ArrayLike,
    u: ArrayLike,
    w: ArrayLike,
    amplitude: ArrayLike,
    noise_power: float,
    sensing: Sensing = "all",
) -> JointBound:
    """Bound of several scatterers whose parameters and complex amplitudes are all unknown.

    The Fisher matrix has six real unknowns a scatterer; the bound is the block
    of the parameters in its inverse. The cost is that of the eigenvalues of a (6K, 6K) matrix and
    of products (K, n) x (n, K) with n each axis's length.

    Parameters
    ----------
    system : System
    array_shape : (int, int)
        Virtual elements (P, Q), at least 2 each.
    range_m, velocity_mps, u, w : array_like, shape (K,)
    amplitude : array_like of complex, shape (K,)
        G of each echo, its carrier phase included. Relative phases matter: scatterers
        closer than a Rayleigh cell are hardest to tell apart where their echoes
        are in phase at the middle of the aperture.
    noise_power : float
        σ² per resource element and virtual element.
    sensing : {"all", "prs"}
        Resource elements that are used.

    Returns
    -------
    JointBound
        Scatterers in one place, or so close that double precision cannot tell
        their Fisher matrix from a singular one, have infinite variances; the
        others' bounds are unaffected.

    Raises
    ------
    InputError
        If the elements that are used do not determine all four parameters of
        a scatterer alone, an amplitude is 0, or numbers are not finite or not as many.

    References
    ----------
    Stoica and Nehorai, "MUSIC, maximum likelihood, and Cramér-Rao bound", IEEE
    Trans. Acoust., Speech, Signal Process. 37 (1989).

    Examples
    --------
    Two equal scatterers half a range bin apart: range is 9 times harder to
    know than for either alone.

    >>> from isacbench.model.numerology import System
    >>> system, one = System(), np.ones(2)
    >>> apart = np.array([0.0, system.range_bin_m / 2])
    >>> in_phase = np.exp(1j * np.pi * np.array([0.0, 0.5]))
    >>> joint = joint_bound(system, (16, 16), 80 + apart, 0 * one, 0 * one, 0 * one, in_phase, 1.0)
    >>> single = single_bound(system, (16, 16), 1.0)
    >>> (joint.range_m / single.range_m).round(1)
    array([9.4, 9.4])
    """
    gain = np.asarray(amplitude, dtype=np.complex128)
    given = {"range_m": range_m, "velocity_mps": velocity_mps, "u": u, "w": w}
    for name, values in given.items():
        same = gain.ndim == 1 and gain.size > 0 and np.shape(values) == gain.shape
        require(same and bool(np.all(np.isfinite(values))), name, values, "as many as amplitudes, finite")
    require(bool(np.all(np.isfinite(gain) & (gain != 0))), "amplitude", gain, "a number other than 0")
    require(0 < noise_power < np.inf, "noise_power", noise_power, "a positive power")
    aperture = _aperture(system, array_shape, sensing)
    places = np.array(list(given.values()), dtype=np.float64) / aperture.units[:, None]
    fisher, scale = _unit_fisher(aperture, places, np.angle(gain))
    covariance = _invert(fisher)
    # From unit columns back to parameters in their units, of echoes of this strength in this noise.
    per_column = aperture.units[:, None] * np.sqrt(noise_power / 2) / np.abs(gain) / scale[1:, None]
    covariance *= per_column[:, :, None, None] * per_column
    joint = covariance.transpose(1, 0, 3, 2)
    k = np.arange(gain.size)
    return JointBound(covariance=joint[k, :, k, :], joint_covariance=joint)


def position_covariance(
    frame: Frame, range_m: ArrayLike, u: ArrayLike, w: ArrayLike, covariance: ArrayLike
) -> Floats:
    """Propagate covariances to positions in space, to first order.

    Parameters
    ----------
    frame : Frame
    range_m, u, w : array_like, shape (K,)
        Places of the scatterers.
    covariance : array_like, shape (K, 4, 4) or (4, 4)
        Of (R, v, u, w), as in `Bound`.

    Returns
    -------
    ndarray of float64, shape (K, 4, 4)
        Of (x, y, z, v), in m and m/s. As in `Bound`, a scatterer without a bound has
        infinite variances and NaN elsewhere. Of x, y and z all is NaN where the
        frame is singular or blind.

    Examples
    --------
    A street's scatterer, seen by a panel: x is uncertain by R times u.

    >>> from isacbench.model.frame import PanelFrame
    >>> from isacbench.model.numerology import System
    >>> bound = single_bound(System(), (16, 16), snr=1e-3)
    >>> xyzv = position_covariance(PanelFrame(), [90.0], [0.01], [0.2], bound.covariance)
    >>> round(float(np.sqrt(xyzv[0, 0, 0]) / (90 * bound.u)), 3)
    1.0
    """
    jacobian = frame.offset_jacobian(range_m, u, w)
    into_space = np.zeros((len(jacobian), N_PARAMETERS, N_PARAMETERS))
    into_space[:, :3, [0, 2, 3]] = jacobian
    into_space[:, 3, 1] = 1
    covariance = np.broadcast_to(np.asarray(covariance, dtype=np.float64), into_space.shape)
    known = np.all(np.isfinite(covariance), axis=(1, 2))
    transported = np.full(into_space.shape, np.nan)
    transported[:, np.arange(N_PARAMETERS), np.arange(N_PARAMETERS)] = np.inf
    into_space = into_space[known]
    transported[known] = into_space @ covariance[known] @ into_space.transpose(0, 2, 1)
    return transported


def _positive(ratio: ArrayLike, name: str) -> Floats:
    """Signal-to-noise ratios as an array, checked."""
    checked = np.asarray(ratio, dtype=np.float64)
    require(bool(np.all((checked > 0) & (checked < np.inf))), name, ratio, "a positive ratio |G|²/σ²")
    return checked


class _Aperture:
    """Samples of an echo: phase slopes per bin along four axes, from their centroids.

    With the centroid as the origin, amplitudes are those at the middle of the
    aperture. That leaves the bound as it is and keeps sums free of
    cancellation. Resource elements are a union of products of subcarriers and
    symbols: one for the full grid, one for each comb offset of the PRS.

    Attributes
    ----------
    units : ndarray, shape (4,)
        Range bin, velocity bin, 1 and 1.
    blocks : list of (ndarray, ndarray)
        Slopes along subcarriers and symbols of each product.
    along_u, along_w : ndarray
        Slopes of the elements.
    reference : ndarray, shape (4,)
        Slopes of the centroid itself, seen from element (0, 0) on subcarrier 0 and symbol 0.
    """

    def __init__(self, system: System, array_shape: tuple[int, int], sensing: Sensing) -> None:
        mask = resource_elements(system, sensing)
        n_c, n_s = mask.shape
        n_p, n_q = array_shape
        require(min(array_shape) >= 2, "array_shape", array_shape, "2 elements and more along u and w")
        along_range, along_doppler = -2 * np.pi / n_c * np.arange(n_c), 2 * np.pi / n_s * np.arange(n_s)
        along_u, along_w = -np.pi * np.arange(n_p), -np.pi * np.arange(n_q)
        share = mask / max(mask.sum(), 1)
        centroid = (
            np.sum(share.T @ along_range),
            np.sum(share @ along_doppler),
            along_u.mean(),
            along_w.mean(),
        )
        self.reference = np.array(centroid)
        self.units = np.array([system.range_bin_m, system.velocity_bin_mps, 1.0, 1.0])
        along_range, along_doppler = along_range - centroid[0], along_doppler - centroid[1]
        self.along_u, self.along_w = along_u - centroid[2], along_w - centroid[3]
        combs, comb_of_symbol = np.unique(mask, axis=1, return_inverse=True)
        self.blocks = [
            (along_range[comb], along_doppler[comb_of_symbol == i])
            for i, comb in enumerate(combs.T)
            if comb.any()
        ]
        determined = self.blocks and np.linalg.matrix_rank(self.moments(), hermitian=True) > N_PARAMETERS
        allowed = f"subcarriers and symbols whose sensed elements ({sensing!r}) determine range and velocity"
        require(bool(determined), "system", system, allowed)

    def moments(self) -> Floats:
        """Sums (5, 5) over all elements of products of 1 and the four slopes."""
        gram = self.gram(np.zeros((N_PARAMETERS, 1)))
        return np.asarray(gram[:, :, 0, 0].real, dtype=np.float64)

    def gram(self, places: Floats) -> Complex:
        """Inner products (5, 5, K, K) of unit echoes and of these times each slope.

        Parameters
        ----------
        places : ndarray, shape (4, K)
            In range bins, velocity bins, u and w.
        """
        # Only differences of places count; small ones keep their digits.
        range_bin, doppler_bin, u, w = places - places.mean(axis=1, keepdims=True)
        delay_doppler: dict[tuple[int, int], Complex] = {}
        for along_range, along_doppler in self.blocks:
            delay, doppler = _kernels(range_bin, along_range), _kernels(doppler_bin, along_doppler)
            for i, j in ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)):
                delay_doppler[i, j] = delay_doppler.get((i, j), 0) + delay[i] * doppler[j]
        over_u, over_w = _kernels(u, self.along_u), _kernels(w, self.along_w)
        # A row's and a column's powers of the four slopes add up.
        powers = np.eye(N_PARAMETERS + 1, N_PARAMETERS, k=-1, dtype=np.int64)
        gram = np.empty((N_PARAMETERS + 1, N_PARAMETERS + 1, *over_u.shape[1:]), dtype=np.complex128)
        for i, j in np.ndindex(gram.shape[:2]):
            in_range, in_doppler, in_u, in_w = (int(power) for power in powers[i] + powers[j])
            gram[i, j] = delay_doppler[in_range, in_doppler] * over_u[in_u] * over_w[in_w]
        return gram


@lru_cache(maxsize=8)
def _aperture(system: System, array_shape: tuple[int, int], sensing: Sensing) -> _Aperture:
    return _Aperture(system, array_shape, sensing)


def _kernels(places: Floats, slopes: Floats) -> Complex:
    """Sums (3, K, K) of x^a exp(jx (place_l - place_k)) over the slopes x, a = 0, 1, 2."""
    waves = np.exp(1j * np.multiply.outer(places, slopes))
    return np.stack([(waves.conj() * slopes**power) @ waves.T for power in range(3)])


def _unit_fisher(aperture: _Aperture, places: Floats, phase: Floats) -> tuple[Floats, Floats]:
    """Fisher matrix of echoes as columns of unit norm, and the norms (5,) of the columns.

    Returns (6, K, 6, K): real and imaginary part of the amplitude, then the four parameters.
    """
    gram = aperture.gram(places)
    norm = np.sqrt(np.diagonal(gram[:, :, 0, 0]).real)
    # Slopes of an echo are j x times the echo, of a change of its amplitude 1 and j times the echo.
    echo = np.exp(1j * (phase + aperture.reference @ places))
    column = np.array([0, *range(N_PARAMETERS + 1)])
    factor = np.array([1, *[1j] * (N_PARAMETERS + 1)])[:, None] * echo
    fisher = np.empty((column.size, echo.size, column.size, echo.size))
    for i, j in np.ndindex(column.size, column.size):
        product = np.outer(factor[i].conj(), factor[j]) * gram[column[i], column[j]]
        fisher[i, :, j, :] = product.real / (norm[column[i]] * norm[column[j]])
    return fisher, norm


def _invert(fisher: Floats) -> Floats:
    """Parameters' block (4, K, 4, K) of the inverse, infinite where the matrix is singular."""
    n_unknowns, n = fisher.shape[:2]
    size = n_unknowns * n
    eigenvalue, vector = np.linalg.eigh(fisher.reshape(size, size))
    # What rounding leaves of an eigenvalue 0.
    floor = size * np.finfo(np.float64).eps * eigenvalue[-1]
    null = eigenvalue < floor
    parameters = vector.reshape(n_unknowns, n, size)[N_NUISANCE:].reshape(-1, size)
    covariance: Floats = (parameters[:, ~null] / eigenvalue[~null]) @ parameters[:, ~null].T
    covariance = covariance.reshape(N_PARAMETERS, n, N_PARAMETERS, n)
    # A scatterer with a share in a null vector, even by its amplitude alone, cannot be told from others.
    shares = vector.reshape(n_unknowns, n, size) ** 2
    lost = shares[:, :, null].sum(axis=2) / floor
    rest = (shares[:, :, ~null] / eigenvalue[~null]).sum(axis=2)
    merged = np.any(lost > NEGLIGIBLE * rest, axis=0)
    covariance[:, merged] = np.nan
    covariance[:, :, :, merged] = np.nan
    for parameter in range(N_PARAMETERS):
        covariance[parameter, merged, parameter, merged] = np.inf
    return covariance
