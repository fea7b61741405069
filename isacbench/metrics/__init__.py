"""Metrics: scores of a point cloud against the truth."""

__all__ = ["cloud_scores", "geometry", "realisations", "score"]
