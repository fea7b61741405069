"""Joint steps of all atoms off the grid, under a ridge on their amplitudes that falls.

Learned atoms are many, and near each other: least squares would let them cancel
and drive them apart. A ridge keeps their amplitudes small, and makes the fit of
the places well posed; as it falls the places become those of least squares.
After each step atoms that are weak compared with their neighbours, or with the
sidelobes of all others, are dropped; after the last, those that others, moved,
can replace in noise. Those that stand for misfit are recognised once no step
follows (`drop_model_error`): earlier, echoes that are not all found look like it.

References
----------
Golub and Pereyra, "The differentiation of pseudo-inverses and nonlinear least
squares problems whose variables separate", SIAM J. Numer. Anal. 10 (1973).
"""

from __future__ import annotations

import numpy as np

from isacbench.checked_arrays import Complex, Floats, Mask
from isacbench.dsp.fitting.atom_fits import NOT_LESS, UNLIMITED, AtomFit, fit_atoms, loaded_step
from isacbench.dsp.fitting.atoms import N_COORDINATES, AtomMap
from isacbench.dsp.fitting.pursuit import BeamSpace, needless_atoms, sidelobe_energy
from isacbench.dsp.floating_point import round_step
from isacbench.dsp.sparse_bayes.places import PITCH, Reach, strongest_near

RIDGES = 1e-2, 1e-3, 1e-3, 1e-4, 1e-4
"""Ridge of each step."""

WEIGHING_RIDGE = 1e-3
"""Least ridge of the amplitudes by which atoms are compared: with less, two that cancel look strong."""

FIRST_DAMPING, LEAST_DAMPING = 0.1, 1e-4
"""Levenberg-Marquardt damping, relative to the information of lone atoms."""

LONGEST_STEP_CELLS = 0.24
"""Longest step along a coordinate; no power of two, where rounding would decide what `round_step` keeps."""

BOX_CELLS = 0.5
"""Largest distance from the first place along each coordinate."""

LOCAL_RANGE_DB = 20.0
"""Range below the strongest atom nearby in which others are no misfit of it."""

NEAR_BINS = 2.0, 2.0
"""Range and Doppler bins that count as nearby."""

FAR_RANGE_DB = 30.0
"""Range below the sidelobes of all atoms in other ranges, in phase, in which others are no misfit of them."""

FAR_BINS = 3.0
"""Distance along range from which an atom is in another range."""

FAR_SHARE = 2 / 3
"""Weight, in decibels, of the sidelobes of other ranges in the misfit; what is left around has the rest."""

ABOVE_MISFIT_DB = 6.0
"""Least power over the misfit at the end."""

REGION_TOLERANCE_M = 0.5
"""Largest distance outside the region."""

LEAST_GAIN = 20.0
"""Least energy over noise that an atom explains and the others, one of them moved, do not: about the highest
that noise shows anywhere on a map."""

MOST_ROUNDS = 3
"""Rounds of dropping atoms at the end."""


def refine_on_map(atom_map: AtomMap, reach: Reach, places: Floats, noise: float) -> AtomFit:
    """Move atoms from places (n, 4) to where they explain the map best, and drop those of its misfit."""
    fit, damping = fit_atoms(atom_map, places, RIDGES[0]), FIRST_DAMPING
    origins = places = places[significant_atoms(fit, reach, RIDGES[0])]
    for ridge in RIDGES:
        fit = fit_atoms(atom_map, places, ridge, fit)
        if not len(fit):
            break
        fit, damping = _moved(fit, ridge, damping, (origins - BOX_CELLS, origins + BOX_CELLS))
        keep = significant_atoms(fit, reach, ridge)
        places, origins = fit.places[keep], origins[keep]
    for _ in range(MOST_ROUNDS):
        fit = fit_atoms(atom_map, places, RIDGES[-1], fit)
        places = places[significant_atoms(fit, reach, RIDGES[-1])]
        if len(places) == len(fit):
            break
    return _drop_needless(fit_atoms(atom_map, places, RIDGES[-1], fit), noise, damping)


def worth(fit: AtomFit, noise: float) -> float:
    """Energy that a fit explains, less the price of its atoms in noise: the better of two explains more."""
    return fit.energy - LEAST_GAIN * noise * len(fit)


def _drop_needless(fit: AtomFit, noise: float, damping: float) -> AtomFit:
    """Drop the atoms that are not worth their price, as others, moved, explain their echoes."""
    while len(fit):
        # On the lattice of other centroids.
        drop, places = needless_atoms(fit, LEAST_GAIN * noise, PITCH)
        if not drop.any():
            break
        fit = fit_atoms(fit.atom_map, places[~drop], RIDGES[-1], fit)
        fit, damping = _moved(fit, RIDGES[-1], damping)
    return fit


def _moved(
    fit: AtomFit, ridge: float, damping: float, limits: tuple[Floats, Floats] = UNLIMITED
) -> tuple[AtomFit, float]:
    """Move all atoms by a step, unless they explain less; returned is the damping of the next one, too."""
    if not len(fit):
        return fit, damping
    step = damped_step(fit, damping)
    moved = fit_atoms(fit.atom_map, np.clip(round_step(fit.places + step, step), *limits), ridge)
    # As in `refine_atoms`: at the optimum rounding must not decide about a step.
    if moved.energy >= (1 - NOT_LESS) * fit.energy:
        return moved, max(damping / 3, LEAST_DAMPING)
    return fit, damping * 5


def significant_atoms(fit: AtomFit, reach: Reach, ridge: float) -> Mask:
    """Tell which atoms lie in the region and are no misfit of others."""
    size = np.abs(_weighed(fit, ridge))
    power = size**2
    far = sidelobe_energy(fit.places, fit.places, power, fit.atom_map.bursts, FAR_BINS)
    keep: Mask = reach.contains(fit.places, REGION_TOLERANCE_M)
    keep &= size > strongest_near(fit.places, size, NEAR_BINS) * 10 ** (-LOCAL_RANGE_DB / 20)
    return keep & (power > far * 10 ** (-FAR_RANGE_DB / 10))


def drop_model_error(fit: AtomFit, reach: Reach, noise: float) -> AtomFit:
    """Drop atoms that are weak compared with both the sidelobes of other ranges and what is left around them.

    Either alone says little: weak echoes lie among strong ones, and are wanted where the map is explained;
    and a crowd's misfit lies among its echoes. The misfit that an atom is compared with is their weighted
    geometric mean. What is left as noise is no misfit. The fit has settled, with the last ridge.
    """
    atom_map, power = fit.atom_map, np.abs(_weighed(fit, RIDGES[-1])) ** 2
    far = sidelobe_energy(fit.places, fit.places, power, atom_map.bursts, FAR_BINS)
    rest = atom_map.without(fit.lines, fit.amplitude)
    space = BeamSpace.from_map(rest, reach.observation.gate, reach.observation.cosine_limits)
    around = space.energy_around(space.beams, fit.places).mean(axis=1)
    misfit = far**FAR_SHARE * np.maximum(around - noise, 0) ** (1 - FAR_SHARE)
    keep = power > misfit * 10 ** (ABOVE_MISFIT_DB / 10)
    return fit_atoms(atom_map, fit.places[keep], RIDGES[-1], fit)


def _weighed(fit: AtomFit, ridge: float) -> Complex:
    """Amplitudes by which atoms are compared."""
    if ridge >= WEIGHING_RIDGE:
        return fit.amplitude
    return fit_atoms(fit.atom_map, fit.places, WEIGHING_RIDGE, fit).amplitude


def damped_step(fit: AtomFit, damping: float) -> Floats:
    """Gauss-Newton step (n, 4) of all places, damped by the information that lone atoms would have.

    In a crowd the others explain most of what an atom's move would: its own information is small, and a share
    of it no bound. A step is at most `LONGEST_STEP_CELLS` along each coordinate.
    """
    diagonal = fit.information.diagonal()
    load = damping * (diagonal + np.tile(fit.power, N_COORDINATES)) + 1e-12 * diagonal.max()
    return loaded_step(fit, load, LONGEST_STEP_CELLS)
