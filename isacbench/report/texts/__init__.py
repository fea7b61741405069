"""Texts for the terminal."""

__all__ = ["contract_findings", "image_plan", "stress_findings"]
