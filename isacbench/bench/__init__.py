"""The harness: suites, cells, runs, stored runs, and their comparison."""

__all__ = ["cells", "compare", "labels", "run", "run_times", "statistics", "store", "suites"]
