"""Propagation against the formula of the continuous waveform, and against what must be conserved."""

import cmath
import math

import numpy as np
import pytest

from isacbench.errors import InputError
from isacbench.link.reception.channel import Paths
from isacbench.link.waveform.ofdm import layout
from isacbench.model.numerology import System
from tests.link.sensing.propagation import propagate


def a_grid(system, seed=0):
    """Gaussian symbols: no two of them alike."""
    parts = np.random.default_rng(seed).normal(size=(2, system.n_subcarriers, system.n_symbols))
    return parts[0] + 1j * parts[1]


def paths_of(system, delay_samples, doppler_ratio, n_elements=2, seed=1):
    """Paths of random gains; delays in samples, Doppler over the subcarrier spacing."""
    rng = np.random.default_rng(seed)
    n = len(delay_samples)
    gain = rng.normal(size=(n, n_elements)) + 1j * rng.normal(size=(n, n_elements))
    delay_s = np.array(delay_samples) / system.bandwidth_hz
    return Paths(gain, delay_s, np.array(doppler_ratio) * system.subcarrier_spacing_hz)


def window(parts, t):
    """Transmit window at a time in samples, from its definition."""
    start, rise = t + parts.n_prefix, parts.n_suffix
    if rise == 0:
        return float(0 <= start < parts.n_symbol)
    if start < 0 or t > parts.n_useful + rise:
        return 0.0
    if start < rise:
        return (1 - math.cos(math.pi * start / rise)) / 2
    if t > parts.n_useful:
        return (1 + math.cos(math.pi * (t - parts.n_useful) / rise)) / 2
    return 1.0


def sent_at(grid, parts, time):
    """Waveform sent at a time in samples from its start: a sum over symbols and subcarriers."""
    total = 0j
    for m in range(grid.shape[1]):
        t = time - m * parts.n_symbol - parts.n_prefix
        if height := window(parts, t):
            waves = (grid[n, m] * cmath.exp(2j * cmath.pi * n * t / len(grid)) for n in range(len(grid)))
            total += height * sum(waves) / math.sqrt(len(grid))
    return total


def received_by_formula(grid, system, paths, n):
    """Received waveform (n, E), one path and sample after the other."""
    parts, rate_hz = layout(system), system.bandwidth_hz
    middle = parts.n_prefix + (parts.n_useful - 1) / 2
    received = np.zeros((n, paths.gain.shape[1]), dtype=complex)
    for gain, delay_s, doppler_hz in zip(paths.gain, paths.delay_s, paths.doppler_hz, strict=True):
        for i in range(n):
            turn = cmath.exp(2j * cmath.pi * doppler_hz * (i - middle) / rate_hz)
            received[i] += gain * turn * sent_at(grid, parts, i - delay_s * rate_hz)
    return received


# Inside the prefix, at its edges, within the next symbol, beyond several symbols, behind the frame. The last
# turn by more than half a turn from sample to sample, which is zero midway between two of them.
DELAYS = [0, 0.3, 1.99, 2, 3.5, 4, 7.25, 12.5, 21.7, 40, 0.4, 5.3, 55.5]
DOPPLERS = [0, 0.02, 0.02, 0.02, 0.02, 0, -0.3, 0, 0.5, -0.1, 11.2, -35.2, 0.02]


@pytest.mark.parametrize("ratios", [(0.25, 0.125), (0.5, 0.5), (0.5, 0), (0, 0)])
def test_the_received_waveform_is_that_of_the_continuous_formula(ratios):
    prefix, suffix = ratios
    system = System(n_subcarriers=16, n_symbols=3, cyclic_prefix_ratio=prefix, cyclic_suffix_ratio=suffix)
    delays, dopplers = (DELAYS, DOPPLERS) if prefix else (DELAYS[:-1], DOPPLERS[:-1])
    paths, grid = paths_of(system, [min(d, 48) for d in delays], dopplers), a_grid(system)
    received = propagate(grid, system, paths)
    np.testing.assert_allclose(
        received, received_by_formula(grid, system, paths, len(received)), rtol=0, atol=1e-12
    )


@pytest.mark.parametrize(
    ("gain", "delay_s", "doppler_hz", "message"),
    [
        (np.ones(2), np.zeros(2), np.zeros(2), r"paths: gain \(2,\), delay_s \(2,\)"),
        (np.ones((2, 1)), np.zeros(2), np.zeros(3), r"doppler_hz \(3,\); allowed are the shapes"),
        ([[np.nan]], [0.0], [0.0], "paths.gain holds nan; allowed are finite numbers"),
        ([[1.0]], [-1e-9], [0.0], "paths.delay_s holds -1e-09; allowed are finite numbers of 0 and more"),
        ([[1.0]], [0.0], [np.inf], "paths.doppler_hz holds inf; allowed are finite numbers"),
    ],
)
def test_paths_that_are_none_are_refused(gain, delay_s, doppler_hz, message):
    with pytest.raises(InputError, match=message):
        Paths(gain, delay_s, doppler_hz)
