"""Cases: hostile but finite input, by subject."""

__all__ = ["crowds", "levels", "map_cases", "places", "radios"]
