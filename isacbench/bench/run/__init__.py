"""Runs: made, resumed, merged, scored again."""

__all__ = ["looks", "merging", "options", "progress", "rescoring", "resume", "runner"]
