"""Comparison of runs and of estimators."""

__all__ = [
    "comparison",
    "matching",
    "ranking",
    "scene_scores",
    "statistics",
    "tolerance",
    "verdicts",
    "worst_scenes",
]
