"""Spectrum of the waveform: its power density, in closed form and measured, and how much leaves the band."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.fft
from scipy.interpolate import CubicSpline, PPoly
from scipy.optimize import brentq

from isacbench.checked_arrays import checked_array
from isacbench.errors import InputError, require
from isacbench.link.waveform.ofdm import layout, n_samples

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from isacbench.model.numerology import System

    Floats = NDArray[np.float64]

NODES, WEIGHTS = np.polynomial.legendre.leggauss(16)
"""Quadrature over one subcarrier spacing, in which the spectrum of a window has a few half-waves."""

CELLS_A_SPACING = 32
"""Cells of the spline through the spectrum of one subcarrier."""

LARGEST_SHARE = 0.999


def window_spectrum(system: System, frequency_hz: ArrayLike) -> Floats:
    """Fourier transform of the transmit window, referred to its middle.

    The window is a rectangle of the symbol time T_OFDM, smoothed by half a
    sine wave as long as the suffix. Its transform is the product of theirs,
    T_OFDM sinc(f T_OFDM) cos(π f T_CS) / (1 - (2 f T_CS)²).

    Parameters
    ----------
    system : System
    frequency_hz : array_like, any shape

    Returns
    -------
    ndarray of float64, same shape
        In s.
    """
    frequency_hz = np.asarray(frequency_hz, dtype=np.float64)
    suffix_time_s = system.cyclic_suffix_ratio / system.subcarrier_spacing_hz
    place = np.abs(frequency_hz) * suffix_time_s
    # The same as cos(πx) / (1 - 4x²), without its 0/0 at x = 1/2.
    smoothing = np.pi / 2 * np.sinc(0.5 - place) / (1 + 2 * place)
    spectrum: Floats = system.symbol_time_s * np.sinc(frequency_hz * system.symbol_time_s) * smoothing
    return spectrum


def power_density(system: System, frequency_hz: ArrayLike) -> Floats:
    """Power spectral density of the waveform of independent symbols of unit power, in closed form.

    Every subcarrier adds the spectrum of the transmit window,
    S(f) = Σ_n |W(f - n Δf)|² / (N T_OFDM). Inside the band that is a ripple
    between subcarriers, because a prefix repeats what was sent.

    Parameters
    ----------
    system : System
    frequency_hz : array_like, any shape
        From subcarrier 0.

    Returns
    -------
    ndarray of float64, same shape
        In 1/Hz; the integral over all frequencies is `mean_power`.

    References
    ----------
    Van Waterschoot et al., "Power spectral density of cyclic prefixed OFDM
    signals", EURASIP J. Wireless Commun. Netw. (2010), have it for a
    rectangular window.
    """
    frequency_hz = np.asarray(frequency_hz, dtype=np.float64)
    density = np.zeros(frequency_hz.shape)
    for subcarrier in range(system.n_subcarriers):
        density += window_spectrum(system, frequency_hz - subcarrier * system.subcarrier_spacing_hz) ** 2
    density /= system.n_subcarriers * system.symbol_time_s
    return density


def mean_power(system: System) -> float:
    """Mean power of the waveform of independent symbols of unit power: below 1 because of the overlap.

    In the overlap the powers of two symbols are weighted by the squares of
    windows whose sum, not whose squares' sum, is 1.

    Parameters
    ----------
    system : System

    Returns
    -------
    float
        1 - T_CS / (4 T_OFDM).

    Examples
    --------
    >>> from isacbench.model.numerology import System
    >>> mean_power(System())
    0.99375
    """
    return 1 - system.cyclic_suffix_ratio / (4 * (1 + system.cyclic_prefix_ratio))


def measured_density(
    waveform: ArrayLike, system: System, oversampling: int, resolution_hz: float
) -> tuple[Floats, Floats]:
    """Measure the power spectral density of the waveform of a frame.

    Bins of the periodogram of the whole frame are averaged. That takes no
    window of its own: where symbols are independent, the mean of a bin over
    their draws is `power_density`, but for what sampling folds.

    Parameters
    ----------
    waveform : array_like, shape (n_samples,)
        As `isacbench.link.waveform.ofdm.modulate` returns it.
    system : System
    oversampling : int
        Sampling rate over the critical one, N Δf.
    resolution_hz : float
        Width that is averaged over; at least one bin is.

    Returns
    -------
    frequency_hz : ndarray of float64, shape (n,)
        Middles of what was averaged, from subcarrier 0; they ascend over one
        sampling rate around the middle of the band.
    density : ndarray of float64, shape (n,)
        In 1/Hz.

    Raises
    ------
    InputError
        If the waveform is not that of a frame, or the resolution is not
        positive.
    """
    require(0 < resolution_hz < np.inf, "resolution_hz", resolution_hz, "a positive number of Hz")
    parts = layout(system, oversampling)
    samples = checked_array("waveform", waveform, np.complex128)
    n = n_samples(parts, system.n_symbols)
    if samples.shape != (n,):
        raise InputError(f"waveform of shape {samples.shape}: allowed is ({n},), a whole frame")
    rate_hz = oversampling * system.bandwidth_hz
    n_bins = scipy.fft.next_fast_len(n)
    amplitude = scipy.fft.fft(samples, n_bins)
    duration_s = system.n_symbols * system.symbol_time_s
    density = (amplitude.real**2 + amplitude.imag**2) / (rate_hz**2 * duration_s)
    lowest = int(np.ceil(n_bins * ((system.n_subcarriers - 1) / (2 * parts.n_useful) - 0.5)))
    n_each = min(max(round(resolution_hz * n_bins / rate_hz), 1), n_bins)
    n_groups = n_bins // n_each
    density = np.roll(density, -lowest)[: n_groups * n_each].reshape(n_groups, n_each).mean(axis=1)
    middle = lowest + (n_each - 1) / 2 + n_each * np.arange(n_groups)
    return middle * rate_hz / n_bins, density


def out_of_band_db(system: System, offset_hz: ArrayLike) -> Floats:
    """Power density beside the band, over the mean density inside it.

    Parameters
    ----------
    system : System
    offset_hz : array_like, any shape
        From the edge of the band, half a subcarrier spacing beyond the last
        subcarrier, to the middle of the subcarrier spacing that is averaged
        over.

    Returns
    -------
    ndarray of float64, same shape
        In dB; the same below the band.
    """
    spacing_hz = system.subcarrier_spacing_hz
    middle_hz = (system.n_subcarriers - 0.5) * spacing_hz + np.asarray(offset_hz, dtype=np.float64)
    density = power_density(system, middle_hz[..., None] + spacing_hz / 2 * NODES)
    inside = mean_power(system) / system.bandwidth_hz
    level_db: Floats = 10 * np.log10(density @ (WEIGHTS / 2) / inside)
    return level_db


def occupied_bandwidth_hz(system: System, share: float = 0.99) -> float:
    """Bandwidth that holds a share of the power of the waveform, as much of the rest below as above.

    Parameters
    ----------
    system : System
    share : float
        Up to 0.999.

    Returns
    -------
    float

    Raises
    ------
    InputError
        If the share is not allowed.

    References
    ----------
    ITU Radio Regulations, 1.153, for a share of 0.99.
    """
    require(0 < share <= LARGEST_SHARE, "share", share, f"more than 0, at most {LARGEST_SHARE}")
    n = system.n_subcarriers
    # The sidelobes of one subcarrier beyond x of them hold less than 1/(π² x) of its power.
    beyond = int(np.ceil(1 / (1 - share)))
    gathered = _gathered_power(system, n + beyond)
    middle = float(gathered(0.0))
    from_subcarriers = (n - 1) / 2 - np.arange(n)

    def excess(half_width: float) -> float:
        return 2 * float(gathered(half_width + from_subcarriers).mean() - middle) - share * mean_power(system)

    return 2 * float(brentq(excess, 0, n / 2 + beyond)) * system.subcarrier_spacing_hz


def _gathered_power(system: System, n_spacings: int) -> PPoly:
    """Integrate the power of one subcarrier over its spectrum, up to some subcarrier spacings away."""
    spacing_hz = system.subcarrier_spacing_hz
    spacings = np.arange(-n_spacings * CELLS_A_SPACING, n_spacings * CELLS_A_SPACING + 1) / CELLS_A_SPACING
    density = window_spectrum(system, spacings * spacing_hz) ** 2 * spacing_hz / system.symbol_time_s
    return CubicSpline(spacings, density).antiderivative()
