"""Recorded cubes: reading them tile by tile from arrays and files, and writing them block by block."""

from isacbench.cubes.opening import open_cube, read_grid
from isacbench.cubes.tiles import TILE_BYTES, Cube, Tile, require_shape
from isacbench.cubes.writing import write_cube

__all__ = [
    "TILE_BYTES",
    "Cube",
    "Tile",
    "frame",
    "image_cost",
    "open_cube",
    "opening",
    "read_grid",
    "require_shape",
    "tiles",
    "transform",
    "write_cube",
    "writing",
]
