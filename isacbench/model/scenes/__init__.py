"""Scenario files and the objects that they name."""

__all__ = ["motion", "raw_uniforms", "scenario", "scene_families"]
