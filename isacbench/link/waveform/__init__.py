"""Transmitted waveform: resource grid, symbols, spectrum, peaks and rates."""

__all__ = [
    "figures_of_merit",
    "ofdm",
    "power_spectrum",
    "qam",
    "resource_grid",
]
