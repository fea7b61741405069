"""Spectrum of the waveform in closed form: its power density and its mean power."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from isacbench.checked_arrays import Floats
from isacbench.model.numerology import System


def window_spectrum(system: System, frequency_hz: ArrayLike) -> Floats:
    """Fourier transform of the transmit window, referred to its middle.

    The window is a rectangle of the symbol time T_OFDM, smoothed by half a
    sine wave as long as the suffix. Its transform is the product of theirs,
    T_OFDM sinc(f T_OFDM) cos(π f T_CS) / (1 - (2 f T_CS)²).

    Parameters
    ----------
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
    return system.symbol_time_s * np.sinc(frequency_hz * system.symbol_time_s) * smoothing


def power_density(system: System, frequency_hz: ArrayLike) -> Floats:
    """Power spectral density of the waveform of independent symbols of unit power, in closed form.

    Every subcarrier adds the spectrum of the transmit window,
    S(f) = Σ_n |W(f - n Δf)|² / (N T_OFDM). Inside the band that is a ripple
    between subcarriers, because a prefix repeats what was sent.

    Parameters
    ----------
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
