"""Similarity of the pictures that two clouds make: occupied pixels of three projections."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.ndimage import gaussian_filter
from skimage.metrics import structural_similarity

from isacbench.checked_arrays import Floats
from isacbench.metrics.descriptions import ScoreColumn
from isacbench.metrics.geometry import CloudPair

PROJECTIONS = (0, 1), (0, 2), (1, 2)

PIXELS_OF_RADIUS = 2
"""Pixels that the radius has: 0.5 m for a radius of 1 m."""

MOST_PIXELS = 1024
"""Pixels along an axis: those of larger regions are larger."""

MARGIN = 3
"""Pixels around the region; points beyond count at the margin's edge."""


@dataclass(frozen=True)
class Occupancy:
    """Structural similarity and error of pictures: points as smooth spots, in three projections."""

    name: ClassVar[str] = "occupancy"
    version: ClassVar[int] = 1
    columns: ClassVar[tuple[ScoreColumn, ...]] = (
        ScoreColumn("ssim", "structural similarity of occupancy where there is any", "", "higher"),
        ScoreColumn("occupancy_nrmse", "normalised root mean square error of occupancy", "", "lower", 1.0),
    )

    def score(self, pair: CloudPair) -> dict[str, float]:
        """Score a pair."""
        pictures = [occupancy_pictures(pair, axes) for axes in PROJECTIONS]
        true, estimated = (np.concatenate([each[side].ravel() for each in pictures]) for side in (0, 1))
        # As scikit-image's `normalized_root_mse`, whose import takes 0.3 s of every process.
        error = np.sqrt(np.mean((true - estimated) ** 2)) / np.sqrt(np.mean(true**2))
        return {
            "ssim": float(np.mean([_similarity(*both) for both in pictures])),
            "occupancy_nrmse": float(error),
        }


def occupancy_pictures(pair: CloudPair, axes: tuple[int, int]) -> tuple[Floats, Floats]:
    """Draw truth and estimate as occupancy: smooth spots of height 1, which do not add up beyond 1.

    On two axes, over the region, or over the truth's bounding box where there is none.
    """
    corners = [] if pair.region is None else [pair.region.lower_m, pair.region.upper_m]
    held = np.vstack([pair.truth.xyz, *corners])[:, list(axes)]
    lower_m, size_m = held.min(axis=0), np.ptp(held, axis=0)
    pixel_m = max(pair.radius_m / PIXELS_OF_RADIUS, float(size_m.max()) / MOST_PIXELS)
    shape = np.ceil(size_m / pixel_m).astype(int) + 2 * MARGIN + 1
    pictures = []
    for cloud in (pair.truth, pair.estimate):
        picture = np.zeros(shape)
        place = np.floor((cloud.xyz[:, list(axes)] - lower_m) / pixel_m) + MARGIN
        picture[tuple(np.clip(place, 0, shape - 1).astype(int).T)] = 1.0
        # A lone spot has the height 1.
        pictures.append(np.minimum(2 * np.pi * gaussian_filter(picture, 1.0, mode="constant"), 1.0))
    return pictures[0], pictures[1]


def _similarity(true: Floats, estimated: Floats) -> float:
    """Mean structural similarity over the pixels that are occupied in either picture: the rest is equal."""
    _, similar = structural_similarity(true, estimated, data_range=1.0, full=True)
    return float(similar[(true > 0) | (estimated > 0)].mean())
