"""Surfaces of objects: solids, meshes and cities, their points, and what of them the base station sees."""

__all__ = ["mesh_files", "solids", "surface_points", "visibility"]
