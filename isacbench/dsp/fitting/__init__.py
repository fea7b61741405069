"""Scatterers fitted to a range-Doppler map: selected, refined and resolved together."""

__all__ = ["atom_fits", "atoms", "grid_pursuit", "joint_selection", "maximum_likelihood", "pursuit"]
