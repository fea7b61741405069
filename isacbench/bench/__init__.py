"""The harness: suites, cells, studies, plans, workers, stored runs, and their comparison."""

__all__ = ["cells", "compare", "plan", "run", "run_times", "statistics", "store", "suites", "workers"]
