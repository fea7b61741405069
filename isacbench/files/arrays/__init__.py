"""Arrays of numbers in files: how they lie there, and how parts of them are read."""

__all__ = [
    "hdf5_datasets",
    "inflated",
    "listing",
    "mapped",
    "mat5",
    "mat73",
    "npy_files",
    "raw_arrays",
    "tiling",
]
