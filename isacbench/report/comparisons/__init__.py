"""Comparison as tables, figure, Markdown and JUnit XML."""

__all__ = ["ci_files", "comparison_figure", "comparison_tables", "ranking_figure", "ranking_tables", "words"]
