"""The plan of a run: cells, blocks, and the job that other processes work on."""

__all__ = ["labels", "run_plan"]
