"""Stored runs: their folder, their rows, and the origin of each row."""

__all__ = ["journal", "manifest", "provenance", "resume", "run", "run_folder", "tables"]
