"""Transmitted waveform: resource grid, symbols, spectrum, peaks and rates."""

__all__ = ["figures_of_merit", "qam", "resource_grid"]
