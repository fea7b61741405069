"""Metrics: scores of a point cloud against the truth."""

__all__ = ["cloud_scores", "deviation", "geometry", "realisations", "score"]
