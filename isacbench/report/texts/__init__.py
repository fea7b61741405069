"""Texts for the terminal, and pages for notebooks."""

__all__ = ["contract_findings", "image_plan", "notebook", "stress_findings", "waveform_merits"]
