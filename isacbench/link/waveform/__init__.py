"""Transmitted waveform: resource grid, symbols, spectrum, peaks and rates."""

__all__ = ["qam", "resource_grid"]
