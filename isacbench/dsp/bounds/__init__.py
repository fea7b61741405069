"""Cramér-Rao bounds of range, velocity and direction cosines.

Data are the echoes of `isacbench.model.echo` on all sensed resource elements
and all virtual elements in white circular complex Gaussian noise of power σ²
each. Each scatterer has four unknown parameters (R, v, u, w) and an unknown
complex amplitude, magnitude and phase: a constant G in the deterministic
bound, random from frame to frame in the stochastic one. The carrier phase
exp(-j4π f_c R/c), which would tell the range to a fraction of the wavelength,
is part of the amplitude and tells nothing here.
"""

from __future__ import annotations

from isacbench.dsp.bounds.cramer_rao_bounds import (
    N_NUISANCE,
    joint_bound,
    position_covariance,
    single_bound,
    stochastic_bound,
)
from isacbench.dsp.bounds.fisher_matrices import N_PARAMETERS, NEGLIGIBLE, Bound, JointBound

__all__ = [
    "NEGLIGIBLE",
    "N_NUISANCE",
    "N_PARAMETERS",
    "Bound",
    "JointBound",
    "joint_bound",
    "position_covariance",
    "single_bound",
    "stochastic_bound",
]
