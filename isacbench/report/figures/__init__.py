"""Figures of a run, of images and of waveforms."""

__all__ = ["background_drawing", "curves", "map_figures", "plotting", "run_figures", "waveform_figures"]
