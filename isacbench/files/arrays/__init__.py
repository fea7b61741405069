"""Arrays of numbers in files: listed by name with shape and type, then read whole or in boxes."""

__all__ = ["array_files", "hdf5_files", "stored_arrays", "zarr_stores"]
