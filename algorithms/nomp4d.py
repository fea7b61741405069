"""Newtonized matching pursuit in range, velocity, u and w, jointly over all cells of the gate.

A scatterer is an atom with four coordinates off any grid. In rounds:

1. The residual, seen through beams towards the region's directions, shows
   where an echo is missing; its products with the derivatives of each atom
   show which atoms are rather two. The moves that gain most are made, one in a
   neighbourhood.
2. All atoms move together by damped Newton steps towards the least-squares fit.
3. Atoms leave that are weak beside their neighbours, that have no place within
   their own Cramér-Rao bound, or that it does not tell from another atom.

No detector is asked: the threshold follows from `pfa` and the noise in Doppler
bins that no speed of the region reaches. A lone scatterer's errors are at the
Cramér-Rao bound (docs/results.md).

Cost of n cells, b beams and K atoms, where the directions of the region span s of
the P Q dimensions of the array: n P Q sqrt(s) once, and in each of a dozen rounds
n K b for the residual and K n s + K³ for a step.

Where two rounds leave more than half of a map unexplained, far above the noise, it
is no sum of a few echoes: more rounds would bend hundreds of atoms to it until
rounding decides where they lie. The pursuit then ends with what it has, and so it
does with the round that reaches `max_scatterers`.

Fails in crowds: where more scatterers share a Rayleigh cell than can be told
apart, no place of the atoms explains the echo, and the least-squares fit bends
them to the misfit. There none is split, moves are bounded to half a cell and atoms
far below their neighbours dropped, yet cell-by-cell estimators image such objects
better.

References
----------
Mamandipoor, Ramasamy and Madhow, "Newtonized orthogonal matching pursuit:
frequency estimation over the continuum", IEEE Trans. SP 64 (2016).
Li and Stoica, "Efficient mixed-spectrum estimation with applications to target
feature extraction", IEEE Trans. SP 44 (1996): RELAX.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import prod
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from isacbench.dsp.cell_detection import white_noise
from isacbench.dsp.fitting.atom_fits import AtomFit, refine_atoms, refit_atoms
from isacbench.dsp.fitting.atoms import N_COORDINATES, AtomMap, product_matrix
from isacbench.dsp.fitting.grating_lobes import best_lobes, lobes_within
from isacbench.dsp.fitting.pursuit import (
    BeamSpace,
    descending,
    noise_maximum,
    redundant,
    split_gains,
    strongest_around,
)
from isacbench.dsp.fitting.pursuit_moves import (
    MOST_LEFT,
    are_near,
    became_pairs,
    choose_moves,
    clear_of_sidelobes,
    reachable_places,
    without_images,
)
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.dsp.scaling import in_unit
from isacbench.errors import require
from isacbench.instrument.stages import stage
from isacbench.model.cloud import PointCloud
from isacbench.model.gate import Gate
from isacbench.model.observation import Observation
from isacbench.plugins.contracts import Needs

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

SPLIT_CERTAINTY = 3.0
"""Gain of a split over the threshold of a new atom: it is the best of many."""

TABOO_CELLS = 0.15
"""Distance from a split that failed, within which none is tried again."""

HOPELESS_CELLS = 0.3
"""Distance from a new atom that changed nothing in a whole round, within which none is tried again."""

BOX_CELLS = 0.5
"""Farthest that an atom moves from where it came in, unless little is left around it."""

CALM, CALM_NOISE = 1e-3, 3.0
"""Residual around an atom, relative to it or to the noise, below which it is not bent to a crowd."""

ROUNDS_TO_EXPLAIN = 2
"""Rounds in which all peaks within 12 dB of the strongest become atoms: of echoes these explain most."""

LEFT_STANDOUT = 100.0
"""Mean residual over the highest output of noise from which noise is not what hides the echoes."""

MOVING_CELLS, PLACE_CELLS = 0.01, 2.0**-12
"""Move in a round from which an atom has not settled, and the lattice that it is put on then."""

STEPS, LAST_STEPS = 2, 3
"""Newton steps in a round, and in each of the last ones."""

LAST_ROUNDS = 2
"""Rounds without moves at the end."""


class _Atoms(NamedTuple):
    """Where atoms are and where they came in, both (n, 4) in Rayleigh cells."""

    places: Floats
    origins: Floats

    def select(self, keep: NDArray[np.bool_]) -> _Atoms:
        return _Atoms(self.places[keep], self.origins[keep])


class _Moves(NamedTuple):
    """Places (n, 4) of new atoms; indices, places and offsets of atoms that become two."""

    added: Floats
    split: NDArray[np.int64]
    centres: Floats
    offsets: Floats

    @classmethod
    def none(cls) -> _Moves:
        """No moves."""
        places = np.empty((0, N_COORDINATES))
        return cls(places, np.empty(0, dtype=np.int64), places, places)

    @property
    def number(self) -> int:
        return len(self.added) + len(self.split)

    def made(self, atoms: _Atoms) -> _Atoms:
        """Atoms with the moves made."""
        kept = np.ones(len(atoms.places), dtype=np.bool_)
        kept[self.split] = False
        new = np.concatenate([self.centres - self.offsets, self.centres + self.offsets, self.added])
        return _Atoms(*(np.concatenate([old[kept], new]) for old in atoms))


class _Seen(NamedTuple):
    """An observation through beams, and the amplitude that is 1 there."""

    observation: Observation
    space: BeamSpace
    white: float
    unit: float


class _Noise(NamedTuple):
    """Noise of an element, threshold of a new atom's energy, and the highest that noise has off the grid."""

    power: float
    threshold: float
    highest: float


class _Pursued(NamedTuple):
    """Atoms, their fit if there are any, and the places (n, 4) of new atoms and of splits that failed."""

    atoms: _Atoms
    fit: AtomFit | None
    hopeless: Floats
    unsplit: Floats

    @classmethod
    def nothing(cls) -> _Pursued:
        """No atoms."""
        places = np.empty((0, N_COORDINATES))
        return cls(_Atoms(places, places), None, places, places)

    @property
    def number(self) -> int:
        return len(self.atoms.places)


@dataclass(frozen=True)
class Nomp4d:
    """Matching pursuit with joint Newton refinement in range, velocity, u and w.

    Attributes
    ----------
    pfa : float
        Probability that noise alone adds an atom to an image; less, because an
        echo must also show in beams between which it loses power.
    local_dynamic_range_db : float
        Below the strongest atom nearby, what is not told from its misfit.
    max_rounds : int
        Most rounds of moves.
    max_scatterers : int
        Most atoms, the strongest moves first: the round that reaches them is
        the last. Time grows with the cube of their number.

    Raises
    ------
    InputError
        If a parameter is out of range.

    Examples
    --------
    >>> from isacbench import load_scenario, observe
    >>> cloud = Nomp4d(max_rounds=2).estimate(observe(load_scenario("street"), snr_db=10))
    >>> 10 < len(cloud) < 466
    True
    """

    name: ClassVar[str] = "nomp4d"
    needs: ClassVar[Needs] = Needs(integration=None)

    pfa: float = 1e-2
    local_dynamic_range_db: float = 16.5
    max_rounds: int = 12
    max_scatterers: int = 500

    def __post_init__(self) -> None:
        require(0 < self.pfa < 1, "pfa", self.pfa, "between 0 and 1")
        require(
            self.local_dynamic_range_db > 0, "local_dynamic_range_db", self.local_dynamic_range_db, "above 0"
        )
        for name in ("max_rounds", "max_scatterers"):
            require(getattr(self, name) >= 1, name, getattr(self, name), "1 and more")

    def estimate(self, observation: Observation) -> PointCloud:
        """Image one observation.

        Parameters
        ----------
        observation : Observation

        Returns
        -------
        PointCloud
        """
        seen = _read_beams(observation)  # 2D-FFT, beams towards the region
        noise = _noise_levels(seen, self.pfa)  # of Doppler bins that no speed of the region reaches
        pursued = _Pursued.nothing()
        for n_rounds in range(self.max_rounds):
            residual = _residual(seen, pursued)
            if n_rounds == ROUNDS_TO_EXPLAIN and _mostly_unexplained(seen.space, residual, noise.highest):
                break
            moves = self._moves(seen, residual, pursued, noise)  # new atoms, and atoms that become two
            if not moves.number:
                break
            n_sought = pursued.number + moves.number
            pursued = self._pursue(seen, residual, pursued, moves, noise)  # joint Newton steps, pruning
            if n_sought >= self.max_scatterers:
                break
        for _ in range(LAST_ROUNDS):
            pursued = self._pursue(seen, _residual(seen, pursued), pursued, _Moves.none(), noise)
        return _to_cloud(seen, pursued)

    def _pursue(
        self, seen: _Seen, residual: Complex, pursued: _Pursued, moves: _Moves, noise: _Noise
    ) -> _Pursued:
        """Make the moves of a round, or none, settle all atoms, and remember the moves that failed."""
        with stage("refinement"):
            n_steps = STEPS if moves.number else LAST_STEPS
            start = moves.made(_released(seen.space, residual, pursued.atoms, pursued.fit, noise.power))
            atoms, fit = self._settle(seen.space.atom_map, seen.observation.gate, start, n_steps, noise)
            is_pair = became_pairs(moves.centres, atoms.places)
            unsplit = np.concatenate([pursued.unsplit, moves.centres[~is_pair]])
            hopeless = pursued.hopeless
            if len(atoms.places) == pursued.number and not is_pair.any():
                hopeless = np.concatenate([hopeless, moves.added])
            return _Pursued(atoms, fit, hopeless, unsplit)

    def _moves(self, seen: _Seen, residual: Complex, pursued: _Pursued, noise: _Noise) -> _Moves:
        """Best moves, one in a neighbourhood, none of those that failed."""
        space, fit = seen.space, pursued.fit
        with stage("peaks"):
            places, gain = space.peaks(residual, noise.threshold)
            eligible = reachable_places(places, seen.observation.gate)
            eligible &= ~are_near(places, pursued.hopeless, HOPELESS_CELLS)
            if fit is not None:
                eligible &= gain > self._weakest(strongest_around(places, fit, space.atom_map.bursts))
            order = descending(gain)
            movable = eligible[order]
            bursts = space.atom_map.bursts
            left = without_images(places, gain, order[movable], order[~movable], bursts)[:MOST_LEFT]
            clear = clear_of_sidelobes(places, gain, order[movable], left, bursts)
            places, gain = places[clear], gain[clear]
            n_new = len(places)
            offsets = np.zeros_like(places)
            if fit is not None:
                around = space.mean_around(residual, fit.places)
                splits = split_gains(space.atom_map, fit, around, SPLIT_CERTAINTY * noise.threshold)
                allowed = ~are_near(fit.places, pursued.unsplit, TABOO_CELLS)
                places = np.concatenate([places, fit.places])
                offsets = np.concatenate([offsets, splits.offsets])
                gain = np.concatenate([gain, np.where(allowed, splits.gain, 0)])
            room = max(self.max_scatterers - (0 if fit is None else len(fit)), 0)
            chosen = choose_moves(places, gain, np.arange(len(places)) < n_new, space.atom_map, room)
            split = chosen[chosen >= n_new]
            return _Moves(places[chosen[chosen < n_new]], split - n_new, places[split], offsets[split])

    def _settle(
        self, atom_map: AtomMap, gate: Gate, atoms: _Atoms, n_steps: int, noise: _Noise
    ) -> tuple[_Atoms, AtomFit | None]:
        """Move all atoms, each in its box, and drop those that explain nothing of their own."""
        if not len(atoms.places):
            return atoms, None
        atoms = _atoms_at_best_lobes(atom_map, gate, atoms)
        fit = refine_atoms(atom_map, atoms.places, n_steps)
        kept = _without_last_digits(fit.places, atoms.places)
        boxed = np.clip(kept, atoms.origins - BOX_CELLS, atoms.origins + BOX_CELLS)
        everyone = np.ones(len(boxed), dtype=np.bool_)
        fit = refit_atoms(atom_map, fit, everyone, boxed)
        while True:
            places = fit.places
            strongest = strongest_around(places, fit, atom_map.bursts)
            weak = fit.power < np.maximum(noise.highest, self._weakest(strongest))
            weak |= np.any(np.abs(places[:, 2:] * atom_map.cell_size[2:]) > 1, axis=1)
            if not weak.any():
                weak, places = redundant(fit, noise.power)
            atoms = _Atoms(places, atoms.origins).select(~weak)
            if not len(atoms.places):
                return atoms, None
            if not weak.any():
                return atoms, fit
            fit = refit_atoms(atom_map, fit, ~weak, places)

    def _weakest(self, strongest: Floats) -> Floats:
        """Energy that an atom beside a stronger one must have."""
        return strongest * 10 ** (-self.local_dynamic_range_db / 10)


def _read_beams(observation: Observation) -> _Seen:
    """Read the range-Doppler map, and look at it through beams towards the region's directions."""
    with stage("rdm"):
        cells, unit = in_unit(observation.cells)
        gated = GatedMap.of(observation, cells)
        atom_map = AtomMap.from_map(gated, observation.system, observation.cosine_limits)
    with stage("detection"):
        white = white_noise(gated)
    with stage("spectrum"):
        space = BeamSpace.from_map(atom_map, observation.gate, observation.cosine_limits)
    return _Seen(observation, space, white, unit)


def _noise_levels(seen: _Seen, pfa: float) -> _Noise:
    """Levels that noise alone exceeds in a share `pfa` of the images."""
    n_independent = seen.space.n_independent
    return _Noise(
        seen.white, seen.white * np.log(n_independent / pfa), seen.white * noise_maximum(n_independent, pfa)
    )


def _residual(seen: _Seen, pursued: _Pursued) -> Complex:
    """Outputs of the beams less the echoes of all atoms."""
    with stage("spectrum"):
        return seen.space.residual(pursued.fit)


def _to_cloud(seen: _Seen, pursued: _Pursued) -> PointCloud:
    """Points at the places of the atoms, with their powers."""
    fit, observation = pursued.fit, seen.observation
    if fit is None:
        return PointCloud.empty()
    with stage("peaks"):
        range_bin, doppler_bin, u, w = (fit.places * seen.space.atom_map.cell_size).T
        n_elements = prod(observation.array.shape)
        # Unit by unit: its square may overflow where the power does not.
        unit_power = fit.power / (n_elements * observation.system.processing_gain) * seen.unit * seen.unit
        return observation.cloud(range_bin, doppler_bin, u, w, unit_power)


def _without_last_digits(places: Floats, starts: Floats) -> Floats:
    """Places (n, 4), of atoms that still move without the digits that rounding would decide.

    In a crowd steps never settle, and each magnifies the last digits of the
    one before: processors would part, and in the end count other atoms.
    """
    moves = np.abs(places - starts).max(axis=1, keepdims=True) > MOVING_CELLS
    return np.where(moves, np.rint(places / PLACE_CELLS) * PLACE_CELLS, places)


def _atoms_at_best_lobes(atom_map: AtomMap, gate: Gate, atoms: _Atoms) -> _Atoms:
    """Atoms, and their boxes, at those of their grating lobes where the map shows them most."""
    if atom_map.bursts.is_whole_frame:
        return atoms
    owner, doppler = lobes_within(atoms.places[:, 1], atom_map.bursts, gate)
    places = atoms.places[owner]
    places[:, 1] = doppler
    lines = atom_map.lines(places)
    gram = product_matrix(atom_map.products(lines), None, None)
    # Of what lies within the gate: of two lobes that counts which explains more.
    scale = 1 / np.sqrt(gram.diagonal())
    gram *= np.multiply.outer(scale, scale)
    chosen = best_lobes(scale * atom_map.correlate(lines).value, gram, owner)
    moved = places[chosen]
    return _Atoms(moved, atoms.origins + moved - atoms.places)


def _released(
    space: BeamSpace, residual: Complex, atoms: _Atoms, fit: AtomFit | None, noise: float
) -> _Atoms:
    """Atoms with new boxes around those that explain almost all that there is."""
    if fit is None:
        return atoms
    around = space.mean_around(residual, atoms.places)
    calm = (around < CALM * fit.power) | (around < CALM_NOISE * noise)
    return _Atoms(atoms.places, np.where(calm[:, None], atoms.places, atoms.origins))


def _mostly_unexplained(space: BeamSpace, residual: Complex, least: float) -> bool:
    """Whether more than half of what the beams hold is left, and noise is not the reason.

    `least` is the highest output of noise: atoms weaker than it are not found.
    """
    held, left = (float(np.vdot(beams, beams).real) for beams in (space.beams, residual))
    return left > LEFT_STANDOUT * least * residual.size and left > held / 2
