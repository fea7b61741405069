"""Interactive pages of runs, rankings and comparisons, each in one HTML file."""

__all__ = ["guarded_pages", "written_pages"]
