"""Cases: hostile but finite input, by subject."""

__all__ = [
    "blanks",
    "crowds",
    "detector_case",
    "digits",
    "estimator_case",
    "ladders",
    "levels",
    "map_cases",
    "places",
    "radios",
    "resolved_shots",
]
