"""Estimators, detectors and metrics as plugins: contracts, where they are found, and their versions."""

__all__ = [
    "class_code",
    "code_files",
    "contracts",
    "discovery",
    "instances",
    "parameters",
    "registry",
    "scoring",
]
