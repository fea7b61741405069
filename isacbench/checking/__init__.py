"""Checks of plugins: scenes, promises, the contract check and stress."""

__all__ = ["contract", "promises", "stress"]
