"""Estimators and detectors as plugins: their contracts, where they are found, and which version they are."""
