"""Checks of plugins: the contract, which `isacbench check` goes through, and the hostile cases of stress."""

__all__ = [
    "case",
    "checks",
    "detector_checks",
    "estimator_checks",
    "image_cases",
    "image_checks",
    "map_cases",
    "map_checks",
    "plugin_check",
    "scenes",
    "stress",
    "stress_tables",
]
