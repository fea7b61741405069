"""Sparse Bayesian learning of echoes: in tiles of a map on grids, and in range blocks off them."""

__all__ = ["first_atoms", "range_blocks", "reach", "ridge_steps", "tapers", "tiles"]
