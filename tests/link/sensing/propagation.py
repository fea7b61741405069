"""Propagation of the waveform in the time domain, exact for any delay: an oracle of echoes and
channels.

A symbol delayed by τ is the inverse DFT of its spectrum times exp(-j2π nΔf τ), times the transmit
window at the delayed instants. Doppler turns the phase along the time axis of the whole frame; it
is zero in the middle of the first symbol's useful part, (N - 1)/2 samples from its start.
"""

import numpy as np

from isacbench.link.waveform.ofdm import checked_grid, layout, n_samples, transmit_window

WHOLE = 4 * np.finfo(np.float64).eps
"""Relative distance up to which a delay is whole: windows without suffix have abrupt ends."""


def delay_samples(delay_s, system):
    """Delays in samples at the critical rate."""
    delay = np.asarray(delay_s, dtype=np.float64) * system.bandwidth_hz
    whole = np.rint(delay)
    return np.where(np.abs(delay - whole) <= WHOLE * whole, whole, delay)


def shown_lags(delay, parts, n_before=0):
    """Latest and earliest symbol, in periods back, that a late echo shows in a receiver's window.

    The window begins so many samples before the useful part, and ends with it.
    """
    late = np.asarray(delay, dtype=np.float64)
    lowest = np.ceil((late - (parts.n_symbol - 1)) / parts.n_symbol)
    highest = np.floor((late + parts.n_useful + parts.n_suffix + n_before) / parts.n_symbol)
    return lowest, highest


def propagate(symbols, system, paths):
    """Waveform (n_samples + longest delay, E) that elements receive of a frame, at the critical rate."""
    parts = layout(system)
    sent = checked_grid(symbols, system).T
    delay, turns = delay_samples(paths.delay_s, system), paths.doppler_hz / system.bandwidth_hz
    time = np.arange(-parts.n_prefix, parts.n_useful)
    doppler = np.exp(2j * np.pi * np.multiply.outer(turns, time - (parts.n_useful - 1) / 2))
    n = n_samples(parts, system.n_symbols) + int(np.ceil(delay.max(initial=0)))
    n_periods = -(-n // parts.n_symbol)
    received = np.zeros((paths.gain.shape[1], n_periods, parts.n_symbol), dtype=np.complex128)
    lowest, highest = shown_lags(delay, parts, parts.n_prefix)
    for lag in np.unique(np.concatenate([lowest, lowest + 1, highest])).astype(int).tolist():
        shown = (lowest <= lag) & (lag <= highest)
        late = delay[shown, None] - lag * parts.n_symbol
        ramps = np.exp(-2j * np.pi * np.mod(late / parts.n_useful, 1) * np.arange(parts.n_useful))
        table = doppler[shown] * transmit_window(parts, time - late)
        for period in range(lag, min(n_periods, len(sent) + lag)):
            samples = np.fft.ifft(sent[period - lag] * ramps, norm="ortho")[:, time] * table
            turned = np.exp(2j * np.pi * turns[shown] * parts.n_symbol * period)
            received[:, period] += (paths.gain[shown] * turned[:, None]).T @ samples
    return received.reshape(len(received), n_periods * parts.n_symbol)[:, :n].T
