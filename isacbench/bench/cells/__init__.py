"""Cells of a run: their plan, their tasks, who works on them in which process, and their rows."""

__all__ = ["cell", "cluster", "images", "plan", "process", "provenance", "rows", "task", "worker"]
