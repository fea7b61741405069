"""Maps of known atoms in noise."""

from dataclasses import replace

import numpy as np

from isacbench.dsp.fitting.atoms import AtomMap
from isacbench.dsp.rangedoppler import GatedMap


def atom(system, shape, gate, place):
    """The atom of a place in the cells of the gate, every transform and aperture written out as a sum."""
    (n_c, n_s), (n_p, n_q) = (system.n_subcarriers, system.n_symbols), shape
    n, m, p, q = (np.arange(size) - (size - 1) / 2 for size in (n_c, n_s, n_p, n_q))
    along_range = np.exp(2j * np.pi / n_c * np.outer(gate.range_bins - place[0], n)).sum(axis=1) / n_c
    along_doppler = np.exp(-2j * np.pi / n_s * np.outer(gate.doppler_bins - place[1], m)).sum(axis=1) / n_s
    along_u = np.exp(-2j * np.pi / n_p * p * place[2]) / np.sqrt(n_p)
    along_w = np.exp(-2j * np.pi / n_q * q * place[3]) / np.sqrt(n_q)
    # Transforms of the map start at the first subcarrier and symbol, not at the middle.
    along_range = along_range * np.exp(1j * np.pi * (n_c - 1) / n_c * gate.range_bins)
    along_doppler = along_doppler * np.exp(-1j * np.pi * (n_s - 1) / n_s * gate.doppler_bins)
    return np.einsum("r,d,p,q->rdpq", along_range, along_doppler, along_u, along_w)


def dense(atom_map, places):
    """Atoms (cells, n) of places; `test_atoms` holds their factors against plain sums."""
    factors = [line.value for line in atom_map.lines(places)]
    return np.einsum("kr,kd,ku,kw->rduwk", *factors).reshape(-1, len(places))


def noisy_map(system, shape, gate, places, amplitude, noise_std, seed=0):
    """Map of echoes in noise of each cell and element of an array."""
    parts = np.random.default_rng(seed).standard_normal((*gate.shape, *shape, 2))
    noise = parts.view(np.complex128)[..., 0] * noise_std * np.sqrt(0.5)
    empty = AtomMap.from_map(GatedMap(noise, gate), system)
    echo = dense(empty, places) @ amplitude
    return replace(empty, cells=empty.cells + echo.reshape(empty.cells.shape))
