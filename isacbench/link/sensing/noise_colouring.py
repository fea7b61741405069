"""Colouring of noise in the gate, as by unequal weights on the resource grid.

Noise of weights q[n, m] has, between cells Δr and Δd bins apart, the covariance

    C(Δr, Δd) = 1/(N M) Σ q²[n, m] exp(j2π n Δr/N) exp(-j2π m Δd/M),

the same wherever they lie and on every element. White noise of the gate is
given that covariance, so that with q = 1 it stays what it is:

- where cells of different range are uncorrelated, as with the PRS, by a root of
  the covariance along Doppler;
- by circulant embedding: on a torus that holds the gate, filled up with white
  noise, the covariance is a product of the transform with eigenvalues. They
  must not be negative, which decides how large a torus has to be. The whole
  map is one on which they are q²;
- where a few strong elements alone make eigenvalues of small tori negative, by
  embedding what remains below a level; the rest of the strong elements' noise
  is drawn on the resource grid and transformed.

All three are exact.

References
----------
Dietrich and Newsam, "Fast and exact simulation of stationary Gaussian processes
through circulant embedding of the covariance matrix", SIAM J. Sci. Comput. 18
(1997); Wood and Chan, "Simulation of stationary Gaussian processes in [0,1]^d",
J. Comput. Graph. Stat. 3 (1994).
"""

from __future__ import annotations

from itertools import product

import numpy as np
import scipy.fft
import scipy.linalg

from isacbench.checked_arrays import Complex, Floats, Integers, parts_of
from isacbench.dsp.partial_dft import doppler_rows, range_rows
from isacbench.model.echo import white_gaussian

NEGLIGIBLE = 1e-12
"""Share of the largest below which covariances and eigenvalues are rounding."""

LEVELS = (1.0, 0.99, 0.98, 0.95, 0.9, 0.8, 0.6, 0.0)
"""Shares of the resource elements below a level, tried in turn; at the last one what remains is white."""

MOST_NUMBERS = 2**22
"""Complex numbers of an intermediate array that are held at a time: 64 MB."""


def noise_covariance(weight: Floats) -> Complex:
    """Compute the covariance of noise between cells of the map, from its amplitude on each resource element.

    E[Z(r + Δr, d + Δd) Z*(r, d)] stands at [Δr, Δd]; negative lags count from the end.
    """
    return scipy.fft.fft(scipy.fft.ifft(weight**2, axis=0), axis=1, norm="forward")


def coloured_noise(white: Complex, weight: Floats, stream: np.random.Generator) -> Complex:
    """Give white noise of a gate, of unit power, the covariance that weights on the resource grid make.

    The result is a linear function of the white noise and of what is drawn from the stream, for the part of a
    torus outside of the gate; the white noise itself where all weights are 1.
    """
    shape, power = white.shape[:2], weight**2
    covariance = noise_covariance(weight)
    if _is_white_along_range(covariance, shape):
        return _coloured_along_doppler(white, covariance)
    # Below the lowest of unequal levels nothing is left to embed.
    levels = np.quantile(power, LEVELS if power.min() > 0 else LEVELS[:1], method="lower")
    for level, torus in product(levels, _small_tori(shape, power.shape)):
        below = noise_covariance(np.sqrt(np.minimum(power, level)))
        spectrum = _spectrum(below, shape, torus)
        if spectrum is not None:
            coloured = _embedded(white, spectrum, stream)
            if level < levels[0]:
                coloured += _drawn_on_grid(np.sqrt(np.maximum(power - level, 0)), white.shape, stream)
            return coloured
    return _embedded(white, power, stream)


def _is_white_along_range(covariance: Complex, shape: tuple[int, ...]) -> bool:
    """Tell whether cells of different range are uncorrelated in the gate."""
    lags = _lags(shape[0], len(covariance))
    largest = float(covariance[0, 0].real)
    return bool(np.all(np.abs(covariance[lags[lags % len(covariance) != 0]]) <= NEGLIGIBLE * largest))


def _lags(n: int, n_all: int) -> Integers:
    """Lags that occur between n consecutive bins; of all bins there are, each once."""
    return np.arange(n_all) if 2 * n - 1 >= n_all else np.arange(1 - n, n)


def _coloured_along_doppler(white: Complex, covariance: Complex) -> Complex:
    """White noise times the Hermitian root of its covariance along Doppler."""
    bins = np.arange(white.shape[1])
    matrix = covariance[0, np.subtract.outer(bins, bins)]
    power, modes = scipy.linalg.eigh(matrix)
    root = (modes * np.sqrt(np.maximum(power, 0))) @ modes.conj().T
    return np.einsum("cd,rdpq->rcpq", root, white, optimize=True)


def _small_tori(shape: tuple[int, ...], whole: tuple[int, ...]) -> list[tuple[int, ...]]:
    """Tori smaller than the whole map on which no lag of the gate meets another, the smallest first."""
    lengths = [
        sorted({min(scipy.fft.next_fast_len(2 * n - 1), n_all), n_all})
        for n, n_all in zip(shape, whole, strict=True)
    ]
    tori = sorted(product(*lengths), key=lambda torus: torus[0] * torus[1])
    return [torus for torus in tori if torus != whole]


def _spectrum(covariance: Complex, shape: tuple[int, ...], torus: tuple[int, ...]) -> Floats | None:
    """Eigenvalues of the covariance on a torus; None where some are negative."""
    on_torus = np.zeros(torus, dtype=np.complex128)
    lags = [
        np.arange(n_all) if length == n_all else _lags(n, n_all)
        for n, n_all, length in zip(shape, covariance.shape, torus, strict=True)
    ]
    on_torus[np.ix_(*lags)] = covariance[np.ix_(*lags)]
    spectrum = scipy.fft.fft(scipy.fft.ifft(on_torus, axis=1, norm="forward"), axis=0).real
    if spectrum.min() < -NEGLIGIBLE * spectrum.max():
        return None
    return np.maximum(spectrum, 0)


def _embedded(white: Complex, spectrum: Floats, stream: np.random.Generator) -> Complex:
    """White noise as part of a torus of it, coloured by the eigenvalues there."""
    shape, n_elements = white.shape[:2], white.shape[2] * white.shape[3]
    by_element = white.reshape(*shape, n_elements).transpose(2, 0, 1)
    coloured = np.empty((n_elements, *shape), dtype=np.complex128)
    amplitude = np.sqrt(spectrum)
    for some in parts_of(n_elements, MOST_NUMBERS // spectrum.size):
        field = white_gaussian(stream, (some.stop - some.start, *spectrum.shape))
        field[:, : shape[0], : shape[1]] = by_element[some]
        grid = scipy.fft.ifft(scipy.fft.fft(field, axis=1, overwrite_x=True), axis=2, overwrite_x=True)
        grid *= amplitude
        cells = scipy.fft.ifft(grid, axis=1, overwrite_x=True)[:, : shape[0]]
        coloured[some] = scipy.fft.fft(cells, axis=2)[:, :, : shape[1]]
    return np.ascontiguousarray(coloured.transpose(1, 2, 0)).reshape(white.shape)


def _drawn_on_grid(amplitude: Floats, shape: tuple[int, ...], stream: np.random.Generator) -> Complex:
    """Noise (n_range, n_doppler, P, Q) of the resource elements of some amplitude, few of them."""
    (n_range, n_doppler, n_p, n_q), (n_subcarriers, n_symbols) = shape, amplitude.shape
    # Where in the map the gate lies does not matter to the law.
    along_range = range_rows(np.arange(n_range), n_subcarriers)
    along_doppler = doppler_rows(np.arange(n_doppler), n_symbols)
    cells = np.zeros((n_range, n_doppler * n_p * n_q), dtype=np.complex128)
    for some in parts_of(n_subcarriers, MOST_NUMBERS // cells.shape[1]):
        lines = np.empty((some.stop - some.start, n_doppler, n_p * n_q), dtype=np.complex128)
        for line, amplitudes in zip(lines, amplitude[some], strict=True):
            symbols = np.flatnonzero(amplitudes)
            noise = white_gaussian(stream, (symbols.size, n_p * n_q))
            line[:] = (along_doppler[:, symbols] * amplitudes[symbols]) @ noise
        cells += along_range[:, some] @ lines.reshape(len(lines), -1)
    return cells.reshape(shape)
