"""Figures of a run and of images."""

__all__ = [
    "chosen_figures",
    "diagnosed_images",
    "map_figures",
    "plotting",
    "run_figures",
]
