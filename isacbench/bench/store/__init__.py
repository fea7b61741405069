"""Stored runs: their folder and their rows."""

__all__ = ["manifest", "run", "run_folder"]
