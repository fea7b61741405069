"""Scenario files, families of generated scenes, and the objects that both consist of."""

__all__ = ["editable_scenes", "raw_uniforms", "scenario", "scene_families"]
