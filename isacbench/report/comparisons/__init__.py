"""A comparison as tables, figure, Markdown and JUnit XML."""

__all__ = ["comparison_figure", "comparison_tables", "junit", "markdown", "words"]
