"""Checks of plugins: whether they keep the contract, and what they do under stress."""

__all__ = ["contract", "stress"]
