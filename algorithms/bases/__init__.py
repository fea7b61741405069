"""Bases of estimators of one school: what they share beyond the stages of the chain."""

__all__ = ["angular_spectra", "joint_subspace", "references"]
