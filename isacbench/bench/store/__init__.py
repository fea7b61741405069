"""Stored runs: their folder, their rows, and the origin of each row."""

__all__ = ["journal", "manifest", "provenance", "run", "run_folder", "tables"]
