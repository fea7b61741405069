"""The harness: suites, cells, studies, plans, workers, stored runs, and their comparison."""

__all__ = ["cells", "compare", "plan", "run", "store", "studies", "suites", "workers"]
