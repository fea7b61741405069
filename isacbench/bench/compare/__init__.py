"""Comparison of runs and of estimators."""
