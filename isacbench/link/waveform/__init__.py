"""The transmitted waveform: resource grid, symbols, spectrum, rates, and copies of it that arrive."""

__all__ = [
    "bit_rates",
    "figures_of_merit",
    "ofdm",
    "papr",
    "power_spectrum",
    "propagation",
    "qam",
    "resource_grid",
    "sent_signal",
]
