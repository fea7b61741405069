"""Runs: made, resumed, merged, scored again."""

__all__ = ["looks", "merging", "options", "plan", "progress", "rescoring", "resume", "runner"]
