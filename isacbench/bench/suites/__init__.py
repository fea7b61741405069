"""Suites, the catalogue of names, and the digests that scenarios are known by."""
