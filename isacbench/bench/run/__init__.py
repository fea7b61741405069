"""Runs: made, gone on with, joined, scored again."""
