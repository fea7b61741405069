"""The transmitted waveform: resource grid, symbols, spectrum, rates, and copies of it that arrive."""
