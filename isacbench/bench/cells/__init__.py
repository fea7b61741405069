"""Cells of a run: what is observed, who works on it, in which process, and the row that comes of it."""

__all__ = ["cell", "cluster", "images", "process", "rows", "task", "worker"]
