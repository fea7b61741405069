"""Suites and their kinds, the catalogue of names, and the digests that scenarios are known by."""

__all__ = [
    "catalogue",
    "detection_kind",
    "efficiency_kind",
    "kind",
    "link_kind",
    "population_kind",
    "resolution_kind",
    "scenario_digest",
    "suite",
    "suite_kinds",
]
