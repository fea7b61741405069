"""Stored runs: their folder, their rows, and where each row comes from."""

__all__ = [
    "csv_table",
    "journal",
    "observed_scenes",
    "provenance",
    "resume",
    "rows",
    "run_folder",
    "run_store",
    "stored_run",
    "validation",
]
