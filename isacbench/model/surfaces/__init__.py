"""Surfaces: meshes, points on them, and their visibility from the base station."""

__all__ = ["mesh_files", "surface_points"]
