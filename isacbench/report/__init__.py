"""Reports: tables, figures and texts of runs, comparisons and images."""

__all__ = ["comparisons", "drawing", "figures", "run_report", "tables", "texts"]
