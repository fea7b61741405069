"""The kinds of suites, a file each: what is planned, measured, summarised, tabulated and drawn."""

__all__ = [
    "detection",
    "drops",
    "efficiency",
    "imaging",
    "kind",
    "link",
    "population",
    "resolution",
    "scores",
]
