"""Runs: made, resumed, merged, scored again."""

__all__ = ["merging", "progress", "rescoring", "runner"]
