"""Promises that images and detections keep, and the small scenes that they are tested on."""

__all__ = ["drift", "image_promises", "map_promises", "promise", "small_scenes"]
