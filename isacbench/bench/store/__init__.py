"""Stored runs: their folder, their rows, and the origin of each row."""

__all__ = [
    "csv_table",
    "journal",
    "provenance",
    "resume",
    "rows",
    "run_folder",
    "run_store",
    "score_columns",
    "stored_run",
]
