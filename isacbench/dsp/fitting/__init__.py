"""Scatterers fitted to a range-Doppler map: selected, refined and told apart together."""

__all__ = [
    "atom_fits",
    "atoms",
    "grating_lobes",
    "grid_pursuit",
    "joint_selection",
    "maximum_likelihood",
    "pursuit",
    "pursuit_moves",
]
