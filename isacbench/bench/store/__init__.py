"""Stored runs: their folder, their rows, and where each row comes from."""
