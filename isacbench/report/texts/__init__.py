"""Texts for the terminal, and pages for notebooks."""
