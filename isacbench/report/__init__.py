"""Reports: tables, figures and texts of runs, comparisons and images."""

__all__ = ["clouds", "comparisons", "findings", "run_report", "tables"]
