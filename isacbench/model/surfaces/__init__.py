"""Surfaces: shapes and meshes, their points, and what of them the base station sees."""

__all__ = ["mesh_files", "shapes", "surface_points", "visibility"]
