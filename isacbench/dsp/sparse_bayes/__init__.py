"""Sparse Bayesian learning of echoes: in tiles of a map on grids, and in range blocks off them."""

__all__ = ["first_atoms", "places", "range_blocks", "ridge_steps", "tiles"]
