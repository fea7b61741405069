"""Maps of known atoms in noise."""

from dataclasses import replace

import numpy as np

from isacbench.dsp.fitting.atoms import AtomMap
from isacbench.dsp.rangedoppler import GatedMap


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
