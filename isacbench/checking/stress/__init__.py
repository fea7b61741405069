"""Stress: hostile but finite input, and what every estimator and every detector promises on it."""

__all__ = ["case", "cases", "runs", "spaces"]
