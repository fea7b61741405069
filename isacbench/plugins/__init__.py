"""Estimators and detectors as plugins: their contracts, where they are found, and which version they are."""

__all__ = [
    "contracts",
    "discovery",
    "error_places",
    "instances",
    "local_files",
    "parameters",
    "plugin_versions",
    "registry",
]
