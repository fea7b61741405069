"""Point clouds in files of several formats."""

__all__ = ["columns", "point_files"]
