"""Bases of estimators of one school: what they share beyond the stages of the chain."""
