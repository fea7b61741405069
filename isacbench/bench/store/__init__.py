"""Stored runs: their folder, their rows, and the origin of each row."""

__all__ = [
    "clouds",
    "journal",
    "manifest",
    "provenance",
    "resume",
    "run",
    "run_folder",
    "score_columns",
    "tables",
]
