"""Texts for the terminal."""

__all__ = ["contract_findings", "stress_findings"]
