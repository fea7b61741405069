"""Recorded cubes: reading them tile by tile from arrays and files, and writing them block by block."""

from isacbench.cubes.opening import open_cube, read_grid
from isacbench.cubes.writing import write_cube

__all__ = ["frame", "image_cost", "open_cube", "opening", "read_grid", "tiles", "write_cube", "writing"]
