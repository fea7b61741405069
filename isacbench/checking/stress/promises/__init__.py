"""Promises: what every estimator and every detector keeps on hostile input."""

__all__ = ["blas_kernels", "image_promises", "map_promises"]
