"""Interference of an echo behind a demodulator: by Doppler within a symbol, and from beyond the
prefix.

An echo S of unit power is, at one subcarrier of one demodulated symbol, Y = X S a + interference,
with the symbol X sent there, a useful gain a, and a sum over all other resource elements whose data
the receiver's window sees. Symbols that are independent, of zero mean and unit power make its power
P a matter of windows alone: the window of the receiver holds samples g_i of the symbol itself and 1
- g_i of those before it, all turned by Doppler. With ε = f_D/Δf,

    a = N^-1 Σ_i g_i exp(j2π ε (i - (N-1)/2)/N)
    P = N^-1 Σ_i (g_i² + (1 - g_i)²) - |a|²
"""

import numpy as np

from isacbench.link.waveform.ofdm import layout, transmit_window
from tests.link.sensing.propagation import delay_samples, shown_lags


def path_interference(system, delay_s, doppler_hz, n_previous=None):
    """Useful gain and interference power of one path, from the symbols sent before."""
    parts = layout(system)
    late, ratio = float(delay_samples(delay_s, system)), doppler_hz / system.subcarrier_spacing_hz
    samples = np.arange(parts.n_useful)
    time = (samples - (parts.n_useful - 1) / 2) / parts.n_useful
    turned = transmit_window(parts, samples - late) * np.exp(2j * np.pi * ratio * time)
    gain = turned.mean()
    # About the mean: of slow echoes the difference of mean squares would be rounding.
    power = np.mean(np.abs(turned - gain) ** 2)
    lowest, highest = (int(lag) for lag in shown_lags(late, parts))
    latest = highest if n_previous is None else min(highest, n_previous)
    for lag in range(max(lowest, 1), latest + 1):
        power += np.mean(transmit_window(parts, samples + lag * parts.n_symbol - late) ** 2)
    return gain, power
