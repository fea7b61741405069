"""Comparison of runs and of estimators."""

__all__ = ["comparison", "matching", "statistics", "tolerance", "verdicts"]
