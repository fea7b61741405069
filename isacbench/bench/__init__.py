"""Suites, the runner and the store of results."""
