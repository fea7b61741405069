"""Interference that a demodulator sees of an echo: by Doppler within a symbol, and from beyond the prefix.

An echo S of unit power is, at one subcarrier of one demodulated symbol,

    Y = X S a + interference

with the symbol X sent there, a useful gain a, and a sum over all other
resource elements whose data the receiver's window sees. Symbols that are
independent, of zero mean and unit power make its power P a matter of windows
alone: the window of the receiver holds samples g_i of the symbol itself and
1 - g_i of those before it, all turned by Doppler. With ε = f_D/Δf,

    a = N^-1 Σ_i g_i exp(j2π ε (i - (N-1)/2)/N)
    P = N^-1 Σ_i (g_i² + (1 - g_i)²) - |a|²

Without Doppler a is the mean of g. Up to the undisturbed prefix g = 1, a is the
Dirichlet kernel sin(πε)/(N sin(πε/N)), and P = 1 - a², which for small ε is
(πε)²/3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from isacbench.errors import InputError
from isacbench.link.waveform.ofdm import layout, transmit_window
from isacbench.link.waveform.propagation import delay_samples, shown_lags
from isacbench.link.waveform.qam import constellation
from isacbench.model.numerology import SPEED_OF_LIGHT_MPS

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from isacbench.choices import Modulation
    from isacbench.link.waveform.ofdm import SymbolLayout
    from isacbench.model.numerology import System

    Complex = NDArray[np.complex128]
    Floats = NDArray[np.float64]

PATHS_TOGETHER = 256
"""Paths whose windows are held at a time: some 10 MB at the paper's size."""


@dataclass(frozen=True, eq=False)
class Interference:
    """What demodulation leaves of unit echoes, and what it adds.

    Attributes
    ----------
    useful_gain : ndarray of complex128, any shape
        Factor on the echo that the closed form has.
    power : ndarray of float64, same shape
        Interference on a resource element, over the power of the echo.
    """

    useful_gain: Complex
    power: Floats

    @property
    def to_signal_db(self) -> Floats:
        """Interference over what is left of the echo, in dB; -inf where nothing interferes."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio_db = 10 * np.log10(self.power) - 20 * np.log10(np.abs(self.useful_gain))
        return np.where(self.power == 0, -np.inf, ratio_db)

    def grid_error_power(self, inverse_power: float = 1.0) -> Floats:
        """Mean square error, against the closed form, of the demodulated grid divided by the symbols sent.

        Parameters
        ----------
        inverse_power : float
            `mean_inverse_power` of the symbols divided by.

        Returns
        -------
        ndarray of float64
            |1 - a|² + P E[1/|X|²], of a unit echo.
        """
        error: Floats = np.abs(1 - self.useful_gain) ** 2 + inverse_power * self.power
        return error


def doppler_gain(doppler_ratio: ArrayLike, n_subcarriers: int) -> Floats:
    """Factor a(ε) that Doppler within a symbol leaves of an echo.

    Parameters
    ----------
    doppler_ratio : array_like, any shape
        Doppler frequency over the subcarrier spacing, ε.
    n_subcarriers : int

    Returns
    -------
    ndarray of float64, same shape
        sin(πε) / (N sin(πε/N)), real because the phase counts from the middle
        of the useful part.

    Examples
    --------
    >>> doppler_gain([0, 0.5, 1], 2048).round(4).tolist()
    [1.0, 0.6366, 0.0]
    """
    turns = np.asarray(doppler_ratio, dtype=np.float64) / n_subcarriers
    # A whole turn is N - 1 half turns of the phase at the ends: with an even N the sign changes.
    whole = np.rint(turns)
    rest = turns - whole
    quotient = np.sinc(n_subcarriers * rest) / np.sinc(rest)
    gain: Floats = quotient * (-1.0) ** (whole * (n_subcarriers - 1) % 2)
    return gain


def doppler_leakage(doppler_ratio: ArrayLike, offset: ArrayLike, n_subcarriers: int) -> Complex:
    """Amplitude with which Doppler within a symbol brings one subcarrier to another.

    Parameters
    ----------
    doppler_ratio : array_like
        Doppler frequency over the subcarrier spacing, ε.
    offset : array_like of int
        Subcarrier that is brought minus the one that receives it, l.
    n_subcarriers : int

    Returns
    -------
    ndarray of complex128, of the shapes broadcast
        N^-1 Σ_i exp(j2π (ε (i - (N-1)/2) + l i)/N), which is a(ε + l)
        exp(jπ l (N-1)/N): real and `doppler_gain` at l = 0.

    Examples
    --------
    >>> leakage = doppler_leakage(0.1, np.arange(16), 16)
    >>> round(float(np.sum(np.abs(leakage) ** 2)), 12)
    1.0
    """
    steps = np.asarray(offset)
    gain = doppler_gain(np.asarray(doppler_ratio, dtype=np.float64) + steps, n_subcarriers)
    phase: Complex = np.exp(1j * np.pi * steps * (n_subcarriers - 1) / n_subcarriers)
    return gain * phase


def mean_inverse_power(modulation: Modulation) -> float:
    """Mean of 1/|X|² over a constellation, by which division strengthens what is not the echo.

    Examples
    --------
    >>> round(mean_inverse_power("16qam"), 6)
    1.888889
    """
    return float(np.mean(1 / np.abs(constellation(modulation)) ** 2))


def echo_interference(
    system: System, range_m: ArrayLike, velocity_mps: ArrayLike, n_previous: int | None = None
) -> Interference:
    """What demodulation leaves of the echoes of scatterers, and the interference that they bring.

    Parameters
    ----------
    system : System
    range_m, velocity_mps : array_like
        Distances, not negative, and radial velocities; shapes that broadcast.
    n_previous : int, optional
        Symbols sent before; by default as many as matter. Nothing precedes the
        first symbol of a frame.

    Returns
    -------
    Interference
        Of the shapes broadcast.

    Raises
    ------
    InputError
        If a distance is negative, a number is not finite, or prefix or suffix
        are no whole samples.

    Examples
    --------
    >>> from isacbench.model.numerology import System
    >>> echo_interference(System(), [100.0, 100.0, 200.0], [0.0, 30.0, 0.0]).to_signal_db.round(1).tolist()
    [-inf, -19.5, -7.3]
    """
    delay_s = 2 * np.asarray(range_m, dtype=np.float64) / SPEED_OF_LIGHT_MPS
    doppler_hz = 2 * np.asarray(velocity_mps, dtype=np.float64) * system.carrier_hz / SPEED_OF_LIGHT_MPS
    return path_interference(system, delay_s, doppler_hz, n_previous)


def path_interference(
    system: System, delay_s: ArrayLike, doppler_hz: ArrayLike, n_previous: int | None = None
) -> Interference:
    """Find what demodulation leaves of single paths, and the interference that they bring.

    Parameters
    ----------
    system : System
    delay_s, doppler_hz : array_like
        Delays, not negative, and Doppler frequencies; shapes that broadcast.
    n_previous : int, optional
        Symbols sent before; by default as many as matter.

    Returns
    -------
    Interference
        Of the shapes broadcast.

    Raises
    ------
    InputError
        As `echo_interference`.
    """
    delays, dopplers = np.broadcast_arrays(
        delay_samples(delay_s, system),
        np.asarray(doppler_hz, dtype=np.float64) / system.subcarrier_spacing_hz,
    )
    if not (np.isfinite(delays) & (delays >= 0) & np.isfinite(dopplers)).all():
        raise InputError(
            "range or delay, and speed or Doppler: allowed are finite numbers, no negative delay"
        )
    parts, shape = layout(system), delays.shape
    late, ratio = delays.ravel(), dopplers.ravel()
    blocks = range(0, late.size, PATHS_TOGETHER)
    results = [
        _of_block(late[k : k + PATHS_TOGETHER], ratio[k : k + PATHS_TOGETHER], parts, n_previous)
        for k in blocks
    ]
    gain = np.concatenate([np.zeros(0, dtype=np.complex128), *(gain for gain, _ in results)])
    power = np.concatenate([np.zeros(0), *(power for _, power in results)])
    return Interference(gain.reshape(shape), power.reshape(shape))


def _of_block(
    late: Floats, ratio: Floats, parts: SymbolLayout, n_previous: int | None
) -> tuple[Complex, Floats]:
    """Useful gain and interference power (k,) of paths late by so many samples."""
    time = (np.arange(parts.n_useful) - (parts.n_useful - 1) / 2) / parts.n_useful
    turned = _window(late, parts, lag=0) * np.exp(2j * np.pi * np.multiply.outer(ratio, time))
    useful: Complex = turned.mean(axis=1)
    # About the mean: of slow echoes the difference of mean squares would be rounding.
    power: Floats = np.mean(np.abs(turned - useful[:, None]) ** 2, axis=1)
    lowest, highest = shown_lags(late, parts)
    for lag in np.unique(np.concatenate([lowest, lowest + 1, highest])):
        if lag >= 1 and (n_previous is None or lag <= n_previous):
            power += np.mean(_window(late, parts, int(lag)) ** 2, axis=1)
    return useful, power


def _window(late: Floats, parts: SymbolLayout, lag: int) -> Floats:
    """Transmit window (k, n_useful) of the symbol sent so many periods before."""
    since = np.arange(parts.n_useful) + lag * parts.n_symbol
    return transmit_window(parts, since - late[:, None])
