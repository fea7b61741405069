"""The link: the downlink waveform, sensing with its echo, and its user."""

__all__ = ["reception", "sensing", "waveform"]
