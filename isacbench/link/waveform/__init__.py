"""Transmitted waveform: resource grid, symbols, spectrum, peaks, rates, and copies of it that arrive."""

__all__ = [
    "figures_of_merit",
    "ofdm",
    "power_spectrum",
    "propagation",
    "qam",
    "resource_grid",
]
