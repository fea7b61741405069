"""Interference of an echo behind a demodulator: by Doppler within a symbol, and from beyond the prefix.

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
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from isacbench.errors import InputError
from isacbench.link.waveform.ofdm import layout, transmit_window
from isacbench.link.waveform.propagation import delay_samples, shown_lags
from isacbench.model.numerology import SPEED_OF_LIGHT_MPS

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from isacbench.link.waveform.ofdm import SymbolLayout
    from isacbench.model.numerology import System

    Complex = NDArray[np.complex128]
    Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Interference:
    """Useful gain of unit echoes behind a demodulator, and the interference that they bring.

    Attributes
    ----------
    useful_gain : ndarray of complex128, any shape
        Factor on the echo that the closed form has.
    power : ndarray of float64, same shape
        Interference on a resource element, over the power of the echo.
    """

    useful_gain: Complex
    power: Floats


def echo_interference(
    system: System, range_m: ArrayLike, velocity_mps: ArrayLike, n_previous: int | None = None
) -> Interference:
    """Compute the useful gain of the echoes of scatterers, and the interference that they bring.

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
    >>> echo_interference(System(), [100.0, 100.0, 200.0], [0.0, 30.0, 0.0]).power.round(3).tolist()
    [0.0, 0.011, 0.157]
    """
    delay_s = 2 * np.asarray(range_m, dtype=np.float64) / SPEED_OF_LIGHT_MPS
    doppler_hz = 2 * np.asarray(velocity_mps, dtype=np.float64) * system.carrier_hz / SPEED_OF_LIGHT_MPS
    return path_interference(system, delay_s, doppler_hz, n_previous)


def path_interference(
    system: System, delay_s: ArrayLike, doppler_hz: ArrayLike, n_previous: int | None = None
) -> Interference:
    """Compute the useful gain of single paths, and the interference that they bring.

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
        raise InputError("range (delay) and speed (Doppler) must be finite, and the delay not negative")
    of_path = partial(_path_interference, parts=layout(system), n_previous=n_previous)
    gain, power = np.vectorize(of_path, otypes=[np.complex128, np.float64])(delays, dopplers)
    return Interference(gain, power)


def _path_interference(
    late: float, ratio: float, parts: SymbolLayout, n_previous: int | None
) -> tuple[complex, float]:
    """Useful gain and interference power of a path late by so many samples."""
    samples = np.arange(parts.n_useful)
    time = (samples - (parts.n_useful - 1) / 2) / parts.n_useful
    turned = transmit_window(parts, samples - late) * np.exp(2j * np.pi * ratio * time)
    useful = turned.mean()
    # About the mean: of slow echoes the difference of mean squares would be rounding.
    power = np.mean(np.abs(turned - useful) ** 2)
    lowest, highest = (int(lag) for lag in shown_lags(late, parts))
    latest = highest if n_previous is None else min(highest, n_previous)
    for lag in range(max(lowest, 1), latest + 1):
        power += np.mean(transmit_window(parts, samples + lag * parts.n_symbol - late) ** 2)
    return complex(useful), float(power)
