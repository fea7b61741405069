"""File formats of cubes and grids."""
