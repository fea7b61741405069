"""The link: the 5G downlink waveform, what its echo is sensed with, and what a user receives of it."""
