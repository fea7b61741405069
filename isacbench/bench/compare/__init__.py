"""Comparison of runs and of estimators."""

__all__ = ["best_alternatives", "comparison", "matching", "regressions", "statistics", "tolerance"]
