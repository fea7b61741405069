"""Suites and their kinds, the catalogue of names, and the digests that scenarios are known by."""

__all__ = ["scenario_digest", "suite", "suite_kinds"]
