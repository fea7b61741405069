"""Checks of plugins: the contract, which `isacbench check` goes through, and the hostile cases of stress."""

__all__ = ["checks", "plugin_check", "stress"]
