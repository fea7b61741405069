"""Instruments of an estimator: stages that are timed, and remarks on an image."""

__all__ = ["remarks", "stages"]
