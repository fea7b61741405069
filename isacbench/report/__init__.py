"""Reports: tables, figures and texts of runs, comparisons and images."""

__all__ = ["clouds", "comparison", "drawing", "figures", "findings", "ranking", "run_report", "tables"]
