"""Stored runs: their folder, their rows, and the origin of each row."""

__all__ = ["manifest", "provenance", "run", "run_folder"]
