"""Scenario files, families of generated scenes, and the objects that both consist of."""

__all__ = ["motion", "raw_uniforms", "scenario", "scene_families"]
