"""Sensing with the waveform: echoes of it, divided by what was sent, as observations."""

__all__ = ["division", "link_observation", "observing"]
