"""Scenario files and the objects that they name."""

__all__ = ["raw_uniforms", "scenario"]
