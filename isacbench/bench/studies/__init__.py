"""Studies: what each kind of suite runs and measures."""

__all__ = [
    "detection_study",
    "efficiency_study",
    "intervals",
    "link_study",
    "medians",
    "power_maps",
    "resolution_study",
    "study",
    "study_kinds",
]
