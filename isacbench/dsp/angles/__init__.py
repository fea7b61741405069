"""Directions of plane waves: apertures, subspaces, model orders, spectra and their peaks."""
