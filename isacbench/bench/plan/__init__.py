"""The plan of a run: cells, blocks, and the job that other processes work on."""

__all__ = ["job", "labels", "run_plan"]
