"""Scatterers fitted to a range-Doppler map: selected, refined and told apart together."""

__all__ = ["atom_fits", "atoms", "grid_pursuit", "joint_selection", "maximum_likelihood", "pursuit"]
