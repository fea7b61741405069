"""Surfaces: shapes and meshes, points on them, and their visibility from the base station."""

__all__ = ["mesh_files", "shapes", "surface_points", "visibility"]
