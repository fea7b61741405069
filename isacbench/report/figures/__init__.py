"""Figures of a run, of images and of waveforms."""
