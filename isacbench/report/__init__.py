"""Reports: tables, figures and texts of runs, comparisons and images."""

__all__ = ["ci_files", "clouds", "comparison", "figures", "findings", "ranking", "run_report", "tables"]
