"""Model of the radio and the scene: numerology, array, frame, scene, gate and echo."""

__all__ = [
    "array",
    "cloud",
    "cloud_files",
    "echo",
    "frame",
    "gate",
    "kernels",
    "link_budget",
    "number_limits",
    "numerology",
    "observation",
    "radio_coordinates",
    "region",
    "scene",
    "scenes",
    "surfaces",
]
