"""Metrics: scores of a point cloud against the truth."""

__all__ = [
    "descriptions",
    "geometry",
    "object_scores",
    "one_to_one",
    "paper",
    "realisations",
    "sensing_targets",
]
