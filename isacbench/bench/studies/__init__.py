"""Studies: the scenes of each kind of suite, what is measured in them, and its summary."""

__all__ = [
    "detection_study",
    "efficiency_study",
    "imaging_study",
    "intervals",
    "link_study",
    "medians",
    "population_study",
    "power_maps",
    "ratios",
    "resolution_study",
    "study",
]
