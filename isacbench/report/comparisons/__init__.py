"""A comparison as tables, figure, Markdown and JUnit XML."""
