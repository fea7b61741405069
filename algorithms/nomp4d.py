"""Newtonized matching pursuit in range, velocity, u and w, jointly over all cells of the gate.

A scatterer is an atom with four coordinates off any grid. In rounds:

1. The residual, seen through beams towards the region's directions, shows
   where an echo is missing. Its products with the derivatives of each atom
   show which atoms should be split into two. The moves that gain most are
   made, one per neighbourhood.
2. All atoms move together by damped Newton steps towards the least-squares fit,
   each within a box around its first place. A ridge on their amplitudes
   keeps them from cancelling each other.
3. Atoms are dropped if they are weak compared with what the map shows of their
   neighbours, or if without them others, one of them moved, explain as much but
   for what noise may show.

After the rounds atoms are dropped that explain no more than the misfit that others
may leave at their place. The misfit of scatterers that are not resolved is highest
beside them, and each false atom leaves one further away.

There is no detector: the threshold follows from `pfa` and the noise in Doppler
bins that no speed of the region reaches. The errors of a single scatterer are at
the Cramér-Rao bound (docs/results.md).

Cost of n cells, b beams and K atoms, where the directions of the region span s of
the P Q dimensions of the array: n P Q sqrt(s) once, and in each of a dozen rounds
n K b for the residual and K n s + K³ for a step.

The pursuit ends when no move is left, after `max_rounds`, or with the round that
reaches `max_scatterers`. What the rounds explain is no reason to end it: of a scene
with many weak echoes two rounds explain less than half.

In crowds, where more scatterers share a Rayleigh cell than can be resolved, no place
of the atoms explains the echo, and the least-squares fit bends them to the misfit.
There no atom is split, moves are bounded to half a cell, and atoms far below their
neighbours are dropped. Of crowds and of whole scenes the images are then about as
good as those of `esprit2d`, with fewer false points, but with more scatterers missed
(docs/methods.md).

References
----------
Mamandipoor, Ramasamy and Madhow, "Newtonized orthogonal matching pursuit:
frequency estimation over the continuum", IEEE Trans. SP 64 (2016).
Li and Stoica, "Efficient mixed-spectrum estimation with applications to target
feature extraction", IEEE Trans. SP 44 (1996): RELAX.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import prod
from typing import ClassVar, NamedTuple

import numpy as np

from isacbench.checked_arrays import Complex, Floats, Integers
from isacbench.cores import one_blas_thread
from isacbench.dsp.cell_detection import white_noise
from isacbench.dsp.fitting.atom_fits import LEAST_DAMPING, AtomFit, fit_atoms, polish_atoms, refine_atoms
from isacbench.dsp.fitting.atoms import N_COORDINATES, AtomMap, product_matrix
from isacbench.dsp.fitting.joint_selection import best_lobes, lobes_within
from isacbench.dsp.fitting.pursuit import (
    MOST_LEFT,
    TIE_DIGITS,
    BeamSpace,
    are_near,
    are_split,
    choose_moves,
    descending,
    drop_lobe_images,
    least_chosen,
    misfit_atoms,
    needless_atoms,
    noise_maximum,
    reachable_places,
    sidelobe_energy,
    split_gains,
    strongest_around,
)
from isacbench.dsp.floating_point import scale_to_unit
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.errors import require, require_least, require_positive
from isacbench.instrument.stages import stage
from isacbench.model.cloud import PointCloud
from isacbench.model.observation import Observation
from isacbench.plugins.contracts import Needs

SPLIT_CERTAINTY = 3.0
"""Required gain of a split, in thresholds of a new atom; higher, because a split is the best of many."""

FAILED_SPLIT_CELLS = 0.15 + 1e-9
"""Distance from a failed split within which no split is tried again. More than that of its halves, but for
rounding."""

FAILED_CELLS = 0.3
"""Distance from a failed new atom (its round changed nothing) within which no new atom is tried again."""

BOX_CELLS = 0.5
"""Half width of the box around an atom's first place that it must not leave, unless little is left there."""

FLAT, FLAT_NOISE = 1e-3, 3.0
"""Residual around an atom, relative to its power or to the noise, below which it gets a new box."""

STEPS = 4
"""Newton steps that are tried in each round; in crowds some explain less and are taken back."""

RIDGE, MOST_RIDGE = 5.0, 1e-2
"""Ridge in powers of noise over the highest that a beam shows; and the largest: a lone atom has 2 % less
energy."""

DOUBTFUL = 10.0
"""Energy lost without an atom while one other moves, over the highest of noise, up to which all are moved."""

MERGED_PITCH = 2.0**-16
"""Lattice of the places of merged atoms, in Rayleigh cells: far below what noise leaves of them."""

STRONGEST_PEAKS = 1000
"""Peaks of the residual among which new atoms are sought first."""

LAST_ROUNDS = 2
"""Rounds without moves at the end."""

LEAST_LEFT = 1e-24
"""Energy, relative to that of the strongest atom, which rounding leaves of a map without noise."""

FINISHING_STEPS = 3
"""Steps at the end with hardly any damping, and as many on the misfit, for the last digits."""

CONVERGED_CELLS = 0.01
"""Largest move by the undamped steps of atoms that have settled; those of a crowd would only move on."""


class _Moves(NamedTuple):
    """Moves of a round: places (n, 4) of new atoms, and atoms that become two.

    Attributes
    ----------
    new : ndarray of float64, shape (n, 4)
        New atoms.
    split : ndarray of int64, shape (m,)
        Indices of the atoms that become two.
    centres, offsets : ndarray of float64, shape (m, 4)
        Places of these atoms, and the offsets of their two parts from there.
    """

    new: Floats
    split: Integers
    centres: Floats
    offsets: Floats

    @property
    def number(self) -> int:
        return len(self.new) + len(self.split)


NO_PLACES = np.empty((0, N_COORDINATES))
NO_MOVES = _Moves(NO_PLACES, np.empty(0, dtype=np.int64), NO_PLACES, NO_PLACES)


@dataclass
class Pursuit:
    """State of a pursuit; places are in Rayleigh cells.

    Attributes
    ----------
    space : BeamSpace
        Beams of its map.
    unit : float
        Amplitude in the observation that is 1 here.
    noise : float
        Noise power of an element.
    threshold : float
        Least energy of a new atom.
    highest_noise : float
        Highest energy of noise at any place, on or off the grid.
    ridge : float
        Weight of the atoms' energies against that of the misfit: `RIDGE` times the power of noise over the
        highest that a beam shows, and 0 at the end if the atoms explain all but noise. Without it two atoms
        of a crowd nearly coincide and cancel, with any energies.
    fit : AtomFit
        Fit of the atoms.
    origins : ndarray of float64, shape (n, 4)
        Centres of their boxes.
    failed, unsplit : ndarray of float64, shape (m, 4)
        Places of failed new atoms, and of failed splits.
    around : ndarray of float64, shape (n,)
        Mean energy of the last residual around each atom.
    is_full : bool
        True if its largest number of atoms ended it.
    """

    observation: Observation
    space: BeamSpace
    unit: float
    noise: float
    threshold: float
    highest_noise: float
    ridge: float
    fit: AtomFit
    origins: Floats = field(default_factory=NO_PLACES.copy)
    failed: Floats = field(default_factory=NO_PLACES.copy)
    unsplit: Floats = field(default_factory=NO_PLACES.copy)
    around: Floats = field(default_factory=lambda: np.empty(0))
    is_full: bool = False

    def residual(self) -> Complex:
        """Outputs of the beams minus the echoes of all atoms; measures `around`."""
        with stage("spectrum"):
            residual = self.space.residual(self.fit)
            self.around = self.space.energy_around(residual, self.fit.places).mean(axis=1)
            return residual

    def release(self) -> None:
        """Centre new boxes on the atoms that explain almost all energy around them."""
        is_flat = (self.around < FLAT * self.fit.power) | (self.around < FLAT_NOISE * self.noise)
        self.origins = np.where(is_flat[:, None], self.fit.places, self.origins)

    def apply(self, moves: _Moves) -> Floats:
        """Places of all atoms after the new ones are added, and those that are split replaced by two."""
        parts = [moves.centres - moves.offsets, moves.centres + moves.offsets, moves.new]
        places, origins = (
            np.concatenate([np.delete(old, moves.split, axis=0), *parts])
            for old in (self.fit.places, self.origins)
        )
        # Two splits a cell apart may meet in one place, where rounding would decide between them.
        _, first = np.unique(np.round(places, TIE_DIGITS), axis=0, return_index=True)
        single = np.sort(first)
        self.origins = origins[single]
        return places[single]

    def move_to_best_lobes(self, places: Floats) -> Floats:
        """Move each atom, with its box, to the grating lobe that fits the map best."""
        atom_map = self.space.atom_map
        owner, doppler = lobes_within(places[:, 1], atom_map.bursts, self.observation.gate)
        at_lobes = places[owner]
        at_lobes[:, 1] = doppler
        lines = atom_map.lines(at_lobes)
        gram = product_matrix(atom_map.products(lines), None, None)
        # Relative to the energy within the gate: of two lobes the one that explains more is chosen.
        scale = 1 / np.sqrt(gram.diagonal())
        gram *= np.multiply.outer(scale, scale)
        moved = at_lobes[best_lobes(scale * atom_map.correlate(lines).value, gram, owner)]
        self.origins = self.origins + moved - places
        return moved

    def drop_misfits(self) -> None:
        """Drop atoms that explain no more than the misfit that others leave there; measures `around`."""
        while True:
            residual = self.residual()
            with stage("refinement"):
                left = self.space.energy_around(residual, self.fit.places).max(axis=1, initial=0)
                stays = ~misfit_atoms(self.fit, left)
                if stays.all():
                    return
                self.origins = self.origins[stays]
                # As of merged atoms: steps without the others would magnify the last digits of places.
                places = np.rint(self.fit.places[stays] / MERGED_PITCH) * MERGED_PITCH
                self.fit = fit_atoms(self.space.atom_map, places, self.ridge)

    def drop_replaceable(self) -> None:
        """Drop atoms without which all others, moved, explain as much but for what noise may show."""
        if not len(self.fit):
            return
        drop, _ = needless_atoms(self.fit, DOUBTFUL * self.highest_noise)
        while drop.any() and not drop.all():
            origins = self.origins[~drop]
            box = origins - BOX_CELLS, origins + BOX_CELLS
            moved = refine_atoms(
                self.space.atom_map, self.fit.places[~drop], STEPS, box, known=self.fit, ridge=self.ridge
            )
            if self.fit.energy - moved.energy <= drop.sum() * self.highest_noise:
                self.fit, self.origins = moved, origins
                return
            # Those that still explain something beside the others stay.
            places = np.concatenate([moved.places, self.fit.places[drop]])
            again = fit_atoms(self.space.atom_map, places, self.ridge, self.fit)
            is_needed = (again.power * again.own)[len(moved) :] > self.highest_noise
            drop[drop] = ~is_needed & is_needed.any()

    def finish(self) -> None:
        """Settle atoms that explain all but noise without a ridge; give settled ones their last digits."""
        if not len(self.fit):
            return
        leaves_noise = self.leaves_below()
        with stage("refinement"):
            atom_map = self.space.atom_map
            if leaves_noise:
                # The ridge moves opposite echoes apart that the map tells apart.
                self.ridge, box = 0.0, (self.origins - BOX_CELLS, self.origins + BOX_CELLS)
                self.fit = refine_atoms(atom_map, self.fit.places, 2 * STEPS, box, known=self.fit)
            places = self.fit.places
            fit = refine_atoms(atom_map, places, FINISHING_STEPS, damping=LEAST_DAMPING, ridge=self.ridge)
            if np.abs(fit.places - places).max() < CONVERGED_CELLS:
                self.fit = polish_atoms(atom_map, fit, FINISHING_STEPS)

    def leaves_below(self, level_db: float = 0.0) -> bool:
        """Tell whether no beam shows more of the residual than the highest noise, or than a level over it."""
        rest = self.residual()
        left = float((rest.real**2 + rest.imag**2).max(initial=0))
        rounding = LEAST_LEFT * float(self.fit.power.max(initial=0))
        return left <= max(self.highest_noise, rounding) * 10 ** (level_db / 10)

    def to_cloud(self) -> PointCloud:
        """Points at the places of the atoms, with their powers."""
        with stage("peaks"):
            return atoms_as_cloud(self.observation, self.fit, self.unit)

    def remember(self, moves: _Moves, n_before: int) -> None:
        """Note the moves of a round that failed.

        Parameters
        ----------
        moves : _Moves
            Of the round.
        n_before : int
            Atoms before it.
        """
        is_pair = are_split(moves.centres, self.fit.places)
        self.unsplit = np.concatenate([self.unsplit, moves.centres[~is_pair]])
        if len(self.fit) == n_before and not is_pair.any():
            self.failed = np.concatenate([self.failed, moves.new])


@dataclass(frozen=True)
class Nomp4d:
    """Matching pursuit with joint Newton refinement in range, velocity, u and w.

    Attributes
    ----------
    pfa : float
        Probability that noise alone adds an atom to an image. The actual one
        is lower: an atom must show in the beams, which lose power between them.
    local_dynamic_range_db : float
        Range below the strongest atom nearby in which others can be
        distinguished from its misfit.
    max_rounds : int
        Largest number of rounds with moves.
    max_scatterers : int
        Largest number of atoms, the strongest moves first: the round that
        reaches it is the last. Time grows with the cube of their number.

    Raises
    ------
    InputError
        If a parameter is out of range.
    """

    name: ClassVar[str] = "nomp4d"
    needs: ClassVar[Needs] = Needs(integration=None)

    pfa: float = 1e-2
    local_dynamic_range_db: float = 16.5
    max_rounds: int = 12
    max_scatterers: int = 500

    def __post_init__(self) -> None:
        require(0 < self.pfa < 1, "pfa", self.pfa, "between 0 and 1")
        require_positive(self, "local_dynamic_range_db")
        require_least(self, max_rounds=1, max_scatterers=1)

    @one_blas_thread()
    def estimate(self, observation: Observation) -> PointCloud:
        """Image one observation."""
        return self.pursue(observation).to_cloud()

    def pursue(self, observation: Observation) -> Pursuit:
        """Explain one observation by atoms.

        Returns
        -------
        Pursuit
            At its end.
        """
        pursuit = _begin(observation, self.pfa)  # 2D-FFT, beams towards the region, noise outside its speeds
        for _ in range(self.max_rounds):
            residual = pursuit.residual()
            moves = self._moves(pursuit, residual)  # new atoms, and atoms that become two
            if not moves.number:
                break
            n_sought = len(pursuit.fit) + moves.number
            self._round(pursuit, moves)  # joint Newton steps, pruning
            pursuit.is_full = n_sought >= self.max_scatterers
            if pursuit.is_full:
                break
        for _ in range(LAST_ROUNDS):
            pursuit.drop_misfits()
            self._round(pursuit, NO_MOVES)
            with stage("refinement"):
                pursuit.drop_replaceable()
        pursuit.finish()
        return pursuit

    def _moves(self, pursuit: Pursuit, residual: Complex) -> _Moves:
        """Choose the best moves, one per neighbourhood, without those that failed before."""
        with stage("peaks"):
            new_places, new_gain = self._new_atoms(pursuit, residual)
            offsets, split_gain = _splits(pursuit)
            places = np.concatenate([new_places, pursuit.fit.places])
            is_new = np.arange(len(places)) < len(new_places)
            room = max(self.max_scatterers - len(pursuit.fit), 0)
            gain = np.concatenate([new_gain, split_gain])
            chosen = choose_moves(places, gain, is_new, pursuit.space.atom_map, room)
            split = chosen[~is_new[chosen]] - len(new_places)
            return _Moves(places[chosen[is_new[chosen]]], split, pursuit.fit.places[split], offsets[split])

    def _new_atoms(self, pursuit: Pursuit, residual: Complex) -> tuple[Floats, Floats]:
        """Places (n, 4) and gains (n,) of new atoms: peaks of the residual that are not sidelobes."""
        places, gain = pursuit.space.peaks(residual, pursuit.threshold)
        order = descending(gain)
        places, gain = places[order], gain[order]
        n = STRONGEST_PEAKS if pursuit.space.atom_map.bursts.is_whole_frame else len(gain)
        while True:
            clear, n_left = self._clear_peaks(pursuit, places[:n], gain[:n])
            # Those much weaker than a move are not chosen.
            if n >= len(gain) or (n_left == MOST_LEFT and gain[n] < least_chosen(gain[clear])):
                return places[clear], gain[clear]
            n *= 4

    def _clear_peaks(self, pursuit: Pursuit, places: Floats, gain: Floats) -> tuple[Integers, int]:
        """Indices of peaks, by descending gain, that may be new atoms, and the number left unexplained."""
        bursts = pursuit.space.atom_map.bursts
        eligible = reachable_places(places, pursuit.observation.gate)
        eligible &= ~are_near(places, pursuit.failed, FAILED_CELLS)
        strongest = strongest_around(places[eligible], pursuit.fit)
        eligible[eligible] = gain[eligible] > self._weakest(strongest)
        candidates, others = np.flatnonzero(eligible), np.flatnonzero(~eligible)
        left = drop_lobe_images(places, gain, candidates, others, bursts)[:MOST_LEFT]
        # Peaks that no move explains have sidelobes, too.
        shown = sidelobe_energy(places[candidates], places[left], gain[left], bursts)
        return candidates[gain[candidates] >= shown], len(left)

    def _round(self, pursuit: Pursuit, moves: _Moves) -> None:
        """Make the moves of a round (possibly none), refine all atoms, and remember the moves that failed."""
        with stage("refinement"):
            n_before = len(pursuit.fit)
            pursuit.release()
            places = pursuit.apply(moves)
            if len(places):
                self._refine(pursuit, places)
            pursuit.remember(moves, n_before)

    def _refine(self, pursuit: Pursuit, places: Floats) -> None:
        """Move all atoms from places (n, 4), each within its box, and drop weak and needless ones."""
        atom_map = pursuit.space.atom_map
        if not atom_map.bursts.is_whole_frame:
            places = pursuit.move_to_best_lobes(places)
        box = pursuit.origins - BOX_CELLS, pursuit.origins + BOX_CELLS
        fit = refine_atoms(atom_map, places, STEPS, box, known=pursuit.fit, ridge=pursuit.ridge)
        while len(fit):
            places = fit.places
            weakest = self._weakest(strongest_around(places, fit))
            stays = fit.power >= np.maximum(pursuit.highest_noise, weakest)
            cosines = np.abs(places[:, 2:] * atom_map.cell_size[2:])
            stays &= np.all(cosines <= pursuit.observation.frame.cosine_scale, axis=1)
            if stays.all():
                drop, places = needless_atoms(fit, pursuit.highest_noise, MERGED_PITCH)
                stays = ~drop
            if stays.all():
                break
            pursuit.origins = pursuit.origins[stays]
            fit = fit_atoms(atom_map, places[stays], pursuit.ridge, fit)
        pursuit.fit = fit

    def _weakest(self, strongest: Floats) -> Floats:
        """Least energy of an atom near a stronger one."""
        return strongest * 10 ** (-self.local_dynamic_range_db / 10)


def _begin(observation: Observation, pfa: float) -> Pursuit:
    """Read the range-Doppler map, form its beams, measure the noise, and derive the levels from it."""
    atom_map, unit, noise = read_atom_map(observation)
    with stage("spectrum"):
        space = BeamSpace.from_map(atom_map, observation.gate, observation.cosine_limits)
    threshold = noise * np.log(space.n_independent / pfa)
    highest_noise = noise * noise_maximum(space.n_independent, pfa)
    strongest = float((space.beams.real**2 + space.beams.imag**2).max(initial=0))
    ridge = RIDGE * noise / max(strongest, RIDGE * noise / MOST_RIDGE, np.finfo(np.float64).tiny)
    no_atoms = fit_atoms(atom_map, NO_PLACES)
    return Pursuit(observation, space, unit, noise, threshold, highest_noise, ridge, no_atoms)


def _splits(pursuit: Pursuit) -> tuple[Floats, Floats]:
    """Offsets (n, 4) of the two parts of each atom, and the energy (n,) that each split gains."""
    offsets, gain = split_gains(pursuit.fit, pursuit.around, SPLIT_CERTAINTY * pursuit.threshold)
    return offsets, np.where(are_near(pursuit.fit.places, pursuit.unsplit, FAILED_SPLIT_CELLS), 0, gain)


def read_atom_map(observation: Observation) -> tuple[AtomMap, float, float]:
    """Read the range-Doppler map as one of atoms, the unit of its amplitudes, and the power of its noise."""
    with stage("rdm"):
        cells, unit = scale_to_unit(observation.cells)
        gated = GatedMap.of(observation, cells)
        atom_map = AtomMap.from_map(gated, observation.system, observation.cosine_limits)
    with stage("detection"):
        return atom_map, unit, white_noise(gated)


def atoms_as_cloud(observation: Observation, fit: AtomFit, unit: float) -> PointCloud:
    """Points at the places of atoms, with their powers; `unit` is the amplitude that is 1 in their map."""
    range_bin, doppler_bin, u, w = (fit.places * fit.atom_map.cell_size).T
    gain = prod(observation.array.shape) * observation.system.processing_gain
    # Unit by unit: its square may overflow where the power does not.
    return observation.cloud(range_bin, doppler_bin, u, w, fit.power / gain * unit * unit)
