"""Point clouds in files of several formats."""

__all__ = ["point_files", "tables"]
