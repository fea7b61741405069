"""Directions of plane waves: apertures, subspaces, model orders, spectra and their peaks."""

__all__ = [
    "aperture",
    "beamformers",
    "line_subspaces",
    "model_order",
    "peaks",
    "planar_spectra",
    "planar_subspaces",
    "plane_waves",
]
