"""Estimators, detectors and metrics as plugins: contracts, where they are found, and their versions."""

__all__ = ["code_digests", "contracts", "discovery", "pickling", "registry", "scoring"]
