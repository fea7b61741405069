"""Comparison as tables, figure, Markdown and JUnit XML."""

__all__ = ["ci_files", "comparison_charts", "comparison_tables", "ranking_charts", "ranking_tables", "words"]
