"""Interference in closed form, against the map from all that is sent to all received."""

from dataclasses import replace

import numpy as np
import pytest

from isacbench.link.reception.channel import Paths
from isacbench.link.waveform.ofdm import demodulate
from isacbench.model.numerology import SPEED_OF_LIGHT_MPS, System
from tests.link.sensing.interference import path_interference
from tests.link.sensing.propagation import propagate

SMALL = System(n_subcarriers=8, n_symbols=3, cyclic_prefix_ratio=0.25, cyclic_suffix_ratio=0.125)
"""Samples of a symbol of the small system, with its prefix of 2."""


def link_map(system, delay_samples, doppler_ratio):
    """Everything received of a unit path, of every resource element sent: (n, m received, n, m sent)."""
    shape = system.n_subcarriers, system.n_symbols
    paths = Paths(
        [[1.0]], [delay_samples / system.bandwidth_hz], [doppler_ratio * system.subcarrier_spacing_hz]
    )
    received = np.empty((*shape, *shape), dtype=complex)
    for place in np.ndindex(shape):
        grid = np.zeros(shape)
        grid[place] = 1
        received[:, :, *place] = demodulate(propagate(grid, system, paths), system)[:, :, 0]
    return received


def closed_form(system, delay_samples, doppler_ratio):
    """Unit echo (n, m) as the closed form has it."""
    n, m = np.arange(system.n_subcarriers)[:, None], np.arange(system.n_symbols)
    turn = doppler_ratio * (1 + system.cyclic_prefix_ratio)
    return np.exp(2j * np.pi * (m * turn - n * delay_samples / system.n_subcarriers))


# Within the prefix, on its falling edge, beyond it, and where two or only earlier symbols show.
@pytest.mark.parametrize(
    ("delay_samples", "doppler_ratio"),
    [(0.65, 0.13), (1.35, -0.8), (4.75, 0), (8.5, 0.13), (10.5, 0), (11.6, 0.1), (15.4, -0.8)],
)
@pytest.mark.parametrize("suffix", [0.125, 0.0])
def test_gain_and_interference_are_those_of_the_whole_map(suffix, delay_samples, doppler_ratio):
    system = replace(SMALL, cyclic_suffix_ratio=suffix)
    whole = link_map(system, delay_samples, doppler_ratio)
    path = delay_samples / system.bandwidth_hz, doppler_ratio * system.subcarrier_spacing_hz
    gain, interference = path_interference(system, *path)
    useful = np.einsum("nmnm->nm", whole)
    echo = closed_form(system, delay_samples, doppler_ratio)
    np.testing.assert_allclose(useful, gain * echo, atol=1e-12)
    power = np.sum(np.abs(whole) ** 2, axis=(2, 3)) - np.abs(useful) ** 2
    for m in range(system.n_symbols):
        np.testing.assert_allclose(power[:, m], path_interference(system, *path, m)[1], atol=1e-12)
    # Two symbols precede the third: more can show nothing at these delays.
    np.testing.assert_allclose(power[:, 2:], interference, atol=1e-12)


def test_interference_begins_where_the_undisturbed_prefix_ends():
    system = System()
    delays_s = 2 * (np.array([-0.2, 0.7]) + system.isi_free_range_m) / SPEED_OF_LIGHT_MPS
    before, behind = (path_interference(system, delay_s, 0.0)[1] for delay_s in delays_s)
    assert before == 0
    assert behind > 1e-12
