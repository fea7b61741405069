"""Sensing with the waveform: echoes of it, divided by what was sent, as observations."""
