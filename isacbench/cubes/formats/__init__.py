"""File formats of cubes and grids."""

__all__ = ["array_cubes", "cube_files", "hdf5", "mat_cubes", "npy_cubes", "npz_cubes", "zarr_cubes"]
