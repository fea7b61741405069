"""Scenario files and the objects that they name."""

__all__ = ["scenario"]
