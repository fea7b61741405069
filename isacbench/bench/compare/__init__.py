"""Comparison of runs and of estimators."""

__all__ = ["comparison", "pairs", "ranking", "scenes", "significance"]
