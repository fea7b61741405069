"""Runs: made, resumed, merged, scored again."""

__all__ = ["looks", "merging", "plan", "progress", "rescoring", "runner"]
