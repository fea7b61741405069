"""Sparse Bayesian learning of echoes: powers of dictionaries of atoms, in tiles of a map and in range blocks."""

__all__ = ["doppler_spectra", "first_atoms", "gathering", "learning", "range_blocks", "ridge_steps", "tapers", "tiles"]
