"""Interactive pages of runs, rankings and comparisons, each in one HTML file."""

__all__ = ["written_pages"]
