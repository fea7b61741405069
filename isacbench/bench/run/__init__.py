"""Runs: made, resumed, merged, scored again."""

__all__ = ["looks", "merging", "progress", "rescoring", "runner"]
