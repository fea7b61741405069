"""Figures of a run, of images and of waveforms."""

__all__ = [
    "chosen_figures",
    "curves",
    "diagnosed_images",
    "map_figures",
    "plotting",
    "run_figures",
    "study_figures",
    "waveform_figures",
]
