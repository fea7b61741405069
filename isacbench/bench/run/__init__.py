"""Runs: made, gone on with, joined, scored again."""

__all__ = ["merging", "progress", "rescoring", "runner"]
