"""Metrics: scores of a point cloud against the truth."""

__all__ = [
    "cloud_scores",
    "columns",
    "deviation",
    "geometry",
    "gospa",
    "objects",
    "one_to_one",
    "realisations",
]
