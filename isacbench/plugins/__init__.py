"""Estimators, detectors and metrics as plugins: contracts, where they are found, and their versions."""

__all__ = [
    "class_code",
    "code_files",
    "contracts",
    "discovery",
    "error_places",
    "instances",
    "local_files",
    "parameters",
    "registry",
    "scoring",
]
