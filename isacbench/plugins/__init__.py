"""Estimators, detectors and metrics as plugins: contracts, where they are found, and their versions."""

__all__ = [
    "contracts",
    "discovery",
    "error_places",
    "instances",
    "local_files",
    "parameters",
    "plugin_versions",
    "registry",
    "scoring",
]
