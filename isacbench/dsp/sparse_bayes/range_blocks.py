"""Learning of atoms off the grid, block by block of range bins.

A block's atoms, and copies of them a fraction of a cell to either side along
each coordinate, compete for what the map holds there: its residual and the
echoes of the block's own atoms. Learning leaves the few that explain it. The
atoms of its neighbours join with their places, so that no block takes their
echoes. Blocks with the largest residual come first.

Cost of K candidates in a block of n cells: K³ a learning step, and K n for their
products; both fall with the length of a block.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from isacbench.checked_arrays import Complex, Floats, Integers
from isacbench.dsp.fitting.atom_fits import fit_atoms
from isacbench.dsp.fitting.atoms import N_COORDINATES, AtomMap, product_matrix
from isacbench.dsp.sparse_bayes.learning import learn_atoms
from isacbench.dsp.sparse_bayes.places import Reach, merge_neighbours, strongest_near

BLOCK_BINS = 8
"""Range bins of a block."""

MARGIN_BINS = 2.0
"""Range bins to either side whose atoms join with their places."""

SIDE_BINS = 4
"""Range bins to either side whose cells a block is learned from."""

COPY_CELLS = 0.15
"""Distance of the copies in Rayleigh cells."""

N_COPIES = 1 + 2 * N_COORDINATES
"""Candidates for each atom, itself included."""

MOST_CANDIDATES = 600
"""Candidates of a block, the strongest first: time grows with the cube of it."""

STEPS = 6
"""Learning steps of a block."""

MISFIT_DB = 35.0
"""Noise floor below the strongest atom of a block, for what its candidates cannot model."""

LEAST_SHARE = 1e-6
"""Least first power over the largest."""

NEIGHBOUR_BOX = np.array([0.15, 0.15, 0.175, 0.175])
"""Half widths in Rayleigh cells of what one scatterer is spread over."""

DYNAMIC_RANGE_DB = 25.0
"""Range below the strongest atom nearby in which others are kept."""

NEAR_BINS = 2.0, 2.0
"""Range and Doppler bins that count as nearby."""

RIDGE = 1e-3
"""Ridge on the amplitudes of a block's atoms."""


@dataclass(frozen=True, eq=False)
class Atoms:
    """Atoms and what they leave of a map.

    Attributes
    ----------
    places : ndarray of float64, shape (n, 4)
        In Rayleigh cells.
    amplitude : ndarray of complex128, shape (n,)
    rest : AtomMap
        The map less their echoes.
    """

    places: Floats
    amplitude: Complex
    rest: AtomMap

    @classmethod
    def of(cls, atom_map: AtomMap, places: Floats, amplitude: Complex) -> Atoms:
        """Subtract the echoes of atoms from a map.

        Parameters
        ----------
        places : ndarray of float64, shape (n, 4)
        amplitude : ndarray of complex128, shape (n,)
        """
        return cls(places, amplitude, atom_map.without(atom_map.lines(places), amplitude))


def learn_blocks(atoms: Atoms, reach: Reach, noise: float) -> Atoms:
    """Learn all atoms anew, one at least, block by block."""
    first = float(np.floor(atoms.places[:, 0].min()))
    for start in _by_residual(atoms, first):
        atoms = _learn_block(atoms, reach, noise, start)
    return atoms


def _by_residual(atoms: Atoms, first: float) -> list[float]:
    """First range bins of the blocks that hold atoms, those with most residual energy first."""
    blocks = np.unique(np.floor((atoms.places[:, 0] - first) / BLOCK_BINS))
    cells = atoms.rest.cells
    energy = np.sum(cells.real**2 + cells.imag**2, axis=(1, 2, 3))
    starts = first + BLOCK_BINS * blocks
    bins = atoms.rest.range_bins
    left = [energy[(bins >= start) & (bins < start + BLOCK_BINS)].sum() for start in starts]
    return [float(starts[block]) for block in np.argsort(-np.array(left), kind="stable")]


def _block(atoms: Atoms, start: float) -> tuple[Integers, Integers, slice]:
    """A block's own atoms, those beside it, and the rows it is learned from."""
    along, end, bins = atoms.places[:, 0], start + BLOCK_BINS, atoms.rest.range_bins
    is_own = (along >= start) & (along < end)
    is_beside = ~is_own & (along >= start - MARGIN_BINS) & (along < end + MARGIN_BINS)
    shown = np.flatnonzero((bins >= start - SIDE_BINS) & (bins <= end + SIDE_BINS))
    rows = slice(int(shown[0]), int(shown[-1]) + 1) if shown.size else slice(0, bins.size)
    return np.flatnonzero(is_own), np.flatnonzero(is_beside), rows


def _learn_block(atoms: Atoms, reach: Reach, noise: float, start: float) -> Atoms:
    """Replace a block's atoms by those that learning leaves of its candidates."""
    own, beside, rows = _block(atoms, start)
    if not own.size:
        return atoms
    members = np.concatenate([own, beside])
    own_map = atoms.rest.without(atoms.rest.lines(atoms.places[members]), -atoms.amplitude[members])
    window = replace(own_map, cells=own_map.cells[rows], range_bins=own_map.range_bins[rows])
    candidates, power = _candidates(atoms, own, beside, reach)
    n_own = len(candidates) - beside.size
    lines = window.lines(candidates)
    gram = product_matrix(window.products(lines), None, None)
    strongest = float(np.abs(atoms.amplitude[members]).max()) ** 2
    floor = max(noise, strongest * 10 ** (-MISFIT_DB / 10))
    index, learned = learn_atoms(gram, window.correlate(lines).value, power, floor, STEPS)
    is_own = index < n_own
    found, strength = merge_neighbours(candidates[index[is_own]], learned[is_own], NEIGHBOUR_BOX)
    found = found[strength > strongest_near(found, strength, NEAR_BINS) * 10 ** (-DYNAMIC_RANGE_DB / 20)]
    others = np.setdiff1d(np.arange(atoms.amplitude.size), members)
    places = np.concatenate([found, atoms.places[beside]])
    amplitude = fit_atoms(window, places, RIDGE).amplitude
    rest = own_map.without(own_map.lines(places), amplitude)
    return Atoms(
        np.concatenate([atoms.places[others], places]),
        np.concatenate([atoms.amplitude[others], amplitude]),
        rest,
    )


def _candidates(atoms: Atoms, own: Integers, beside: Integers, reach: Reach) -> tuple[Floats, Floats]:
    """Places and first powers of a block's candidates, and behind them those of the atoms beside it."""
    steps = COPY_CELLS * np.concatenate([np.zeros((1, N_COORDINATES)), np.eye(4), -np.eye(4)])
    places = (steps[:, None] + atoms.places[own]).reshape(-1, N_COORDINATES)
    power = np.tile(np.abs(atoms.amplitude[own]) ** 2 / N_COPIES, N_COPIES)
    allowed = reach.contains(places) | (np.arange(len(places)) < own.size)
    places, power = places[allowed], power[allowed]
    strongest = np.sort(np.argsort(-power, kind="stable")[:MOST_CANDIDATES])
    power = np.concatenate([power[strongest], np.abs(atoms.amplitude[beside]) ** 2])
    places = np.concatenate([places[strongest], atoms.places[beside]])
    return places, np.maximum(power, LEAST_SHARE * power.max())
