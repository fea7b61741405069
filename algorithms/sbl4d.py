"""Sparse Bayesian learning in range, velocity, u and w: first on grids, then of atoms off any grid.

Echoes of an object are closer than the radio resolves, and in phase they add up
to a smooth field with most of its energy at the object's edges. The strongest
place of a field is then the place of nothing. Learning instead starts from all
places at once, and lets them compete for the field: what is left is close to
the scatterers, or to centroids of a few, wherever noise allows to tell.

1. A short pursuit (`nomp4d`) tries to explain the map by few atoms. If it leaves
   noise alone, its atoms are the image: lone scatterers, at the Cramér-Rao bound.
   Where noise hides the misfit of all that it leaves, it goes on to its end.
2. First atoms, from range-Doppler tiles of the tapered map
   (`isacbench.dsp.sparse_bayes.first_atoms`): Doppler spectra, the static layer,
   moving echoes with Doppler as a coordinate, angular sectors.
3. All atoms settle together off the grid under a falling ridge, and those that
   are weak compared with others nearby are dropped (`ridge_steps`). Those of a
   finished pursuit take their place, and that of the image at the end, if they
   explain the map better, each at its price in noise.
4. The residual is learned in the same way without a taper along range: objects
   whose echoes are in phase have their energy at the edge of the band, which a
   taper removes.
5. All atoms, and copies of them to all sides, are learned again, block by block
   of range bins (`range_blocks`), and settle again. Those that stand for what
   others leave are dropped.

If a large share of the map's energy is left, atoms are no model of it: a remark
says so, and the image is that of `esprit2d`.

References
----------
Tipping, "Sparse Bayesian learning and the relevance vector machine", J. Machine
Learning Research 1 (2001).
Wipf and Rao, "An empirical Bayesian strategy for solving the simultaneous sparse
approximation problem", IEEE Trans. SP 55 (2007).
Stoica and Babu, "SPICE and LIKES: two hyperparameter-free methods for sparse-
parameter estimation", Signal Processing 92 (2012).
Golub and Pereyra, "The differentiation of pseudo-inverses and nonlinear least
squares problems whose variables separate", SIAM J. Numer. Anal. 10 (1973).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isacbench.checked_arrays import Complex, Floats
from isacbench.cores import one_blas_thread
from isacbench.dsp.fitting.atom_fits import AtomFit, fit_atoms
from isacbench.dsp.sparse_bayes.first_atoms import SAME_PLACE, first_atoms
from isacbench.dsp.sparse_bayes.places import PITCH, Reach
from isacbench.dsp.sparse_bayes.range_blocks import Atoms, learn_blocks
from isacbench.dsp.sparse_bayes.ridge_steps import RIDGES, drop_model_error, refine_on_map, worth
from isacbench.dsp.sparse_bayes.tiles import BinTaper
from isacbench.errors import require_least
from isacbench.instrument.remarks import remark
from isacbench.instrument.stages import stage
from isacbench.model.cloud import PointCloud
from isacbench.model.observation import Observation
from isacbench.plugins.contracts import Needs

from .esprit2d import Esprit2d
from .nomp4d import NO_PLACES, Nomp4d, atoms_as_cloud, read_atom_map

LEAST_NOISE = 1e-12
"""Least noise power over the map's strongest cell: without noise the misfit of the grids decides."""

FIRST_RIDGE = 1e-2
"""Ridge on the amplitudes of atoms that have not settled."""

MOST_UNEXPLAINED = 0.5
"""Share of the map's energy above noise from which atoms are no model of it: of weak maps much is below the
price of an atom."""

NOISE_DEVIATIONS = 6.0
"""Standard deviations by which a cell's mean power exceeds that of noise if it holds echoes."""


@dataclass(frozen=True)
class Sbl4d:
    """Sparse Bayesian learning with joint Newton steps in range, velocity, u and w.

    Attributes
    ----------
    lone_scatterers : int
        Largest number of scatterers that the pursuit may explain a map with; 0
        leaves the pursuit out.
    max_scatterers : int
        Largest number of atoms that settle together, the strongest first. Time
        grows with the cube of it, memory with the square. A remark says where
        it acts.

    Raises
    ------
    InputError
        If a parameter is out of range.
    """

    name: ClassVar[str] = "sbl4d"
    needs: ClassVar[Needs] = Needs(integration=None)

    lone_scatterers: int = 32
    max_scatterers: int = 500

    def __post_init__(self) -> None:
        require_least(self, lone_scatterers=0, max_scatterers=1)

    @one_blas_thread()
    def estimate(self, observation: Observation) -> PointCloud:
        """Image one observation."""
        pursued = NO_PLACES
        if self.lone_scatterers:
            pursuit = Nomp4d(max_scatterers=self.lone_scatterers).pursue(observation)
            if pursuit.leaves_below():
                return pursuit.to_cloud()
            if pursuit.leaves_below(Nomp4d.local_dynamic_range_db):  # noise hides the misfit of the rest
                if pursuit.is_full:
                    pursuit = Nomp4d(max_scatterers=self.max_scatterers).pursue(observation)
                pursued = np.rint(pursuit.fit.places / PITCH) * PITCH  # as centroids of learned atoms
        reach, noise, unit = _read(observation)
        if not noise:
            return PointCloud.empty()  # all cells are 0
        of_pursuit = fit_atoms(reach.atom_map, pursued, RIDGES[-1])
        first = _better(self._first_image(reach, noise), of_pursuit, noise)
        fit = _better(self._second_image(reach, noise, first), of_pursuit, noise)
        return self._checked(reach, noise, fit, unit)

    def _first_image(self, reach: Reach, noise: float) -> AtomFit:
        """Learn the tapered map, and let its atoms settle."""
        with stage("spectrum"):
            taper = BinTaper.hann(reach.atom_map.range_bins)
            places, strength = first_atoms(reach.atom_map, reach, noise, taper)
        return self._settled(reach, noise, self._strongest(places, strength))

    def _second_image(self, reach: Reach, noise: float, fit: AtomFit) -> AtomFit:
        """Learn the residual, then all atoms block by block, and let them settle again."""
        atom_map = reach.atom_map
        with stage("spectrum"):
            rest = atom_map.without(fit.lines, fit.amplitude)
            taper = BinTaper.none(atom_map.range_bins)
            places, strength = first_atoms(rest, reach, noise, taper)
            distance = np.abs(places[:, None] - fit.places)
            is_new = ~np.all(distance <= SAME_PLACE, axis=2).any(axis=1)
            found = np.concatenate([fit.places, places[is_new]])
            found = self._strongest(found, np.concatenate([np.abs(fit.amplitude), strength[is_new]]))
        if not len(found):
            return fit
        with stage("refinement"):
            loaded = fit_atoms(atom_map, found, FIRST_RIDGE)
            atoms = learn_blocks(Atoms.of(atom_map, found, loaded.amplitude), reach, noise)
        settled = self._settled(reach, noise, self._strongest(atoms.places, np.abs(atoms.amplitude)))
        with stage("refinement"):
            return drop_model_error(settled, reach, noise)

    def _settled(self, reach: Reach, noise: float, places: Floats) -> AtomFit:
        with stage("refinement"):
            return refine_on_map(reach.atom_map, reach, places, noise)

    def _strongest(self, places: Floats, strength: Floats) -> Floats:
        """Places of as many atoms as may settle together, the strongest ones."""
        remark("crowded", max(len(places) - self.max_scatterers, 0), len(places))
        chosen = np.argsort(-strength, kind="stable")[: self.max_scatterers]
        return places[np.sort(chosen)]

    def _checked(self, reach: Reach, noise: float, fit: AtomFit, unit: float) -> PointCloud:
        """The atoms as an image, or that of `esprit2d` where they leave too much of the map."""
        atom_map = reach.atom_map
        rest = atom_map.without(fit.lines, fit.amplitude)
        shown = _energy_above_noise(atom_map.cells, noise)
        fails = _energy_above_noise(rest.cells, noise) > MOST_UNEXPLAINED * shown
        remark("unexplained", int(fails), 1)
        if fails:
            return Esprit2d().estimate(reach.observation)
        with stage("peaks"):
            return atoms_as_cloud(reach.observation, fit, unit)


def _read(observation: Observation) -> tuple[Reach, float, float]:
    """Read the range-Doppler map; measure its noise. Returned is the unit of its amplitudes, too."""
    atom_map, unit, noise = read_atom_map(observation)
    with stage("detection"):
        largest = float((atom_map.cells.real**2 + atom_map.cells.imag**2).max())
        noise = max(noise, LEAST_NOISE * largest)
    return Reach(observation, atom_map), noise, unit


def _better(fit: AtomFit, other: AtomFit, noise: float) -> AtomFit:
    """The fit that explains more of the map, each atom at its price in noise."""
    return fit if worth(fit, noise) >= worth(other, noise) else other


def _energy_above_noise(cells: Complex, noise: float) -> float:
    """Energy of the range-Doppler cells that show more than noise, less its own."""
    n_elements = cells.shape[2] * cells.shape[3]
    power = np.mean(cells.real**2 + cells.imag**2, axis=(2, 3))
    excess = power - noise * (1 + NOISE_DEVIATIONS / np.sqrt(n_elements))
    return float(excess[excess > 0].sum())
