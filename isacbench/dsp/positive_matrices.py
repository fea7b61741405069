"""Inverses and equations of symmetric positive definite matrices, by Cholesky factors."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv, dpotrf, dpotri

from isacbench.checked_arrays import Floats, Mask

SMALL = 16
"""Rows up to which a matrix is inverted as it is."""


def inverse_of_lower(factor: NDArray[Any]) -> NDArray[Any]:
    """Inverses of lower triangular matrices (..., d, d), by halves."""
    if (half := factor.shape[-1] // 2) < SMALL // 2:
        return np.linalg.inv(factor)
    inverse = np.zeros_like(factor)
    first = inverse[..., :half, :half] = inverse_of_lower(factor[..., :half, :half])
    second = inverse[..., half:, half:] = inverse_of_lower(factor[..., half:, half:])
    np.matmul(-second, factor[..., half:, :half] @ first, out=inverse[..., half:, :half])
    return inverse


def inverse_of_positive(matrix: Floats) -> NDArray[Any]:
    """Inverse of one matrix (d, d), by pivots where rounding leaves it indefinite."""
    factor, failed = dpotrf(matrix.T)
    if failed:
        return np.linalg.inv(matrix)
    upper = np.triu(dpotri(factor, overwrite_c=True)[0])
    return upper + np.triu(upper, 1).T


def solve_positive(matrix: Floats, right: Floats) -> NDArray[Any]:
    """Solve equations (d, d) with right sides (d,); by pivots where rounding leaves the matrix indefinite."""
    _, solution, failed = dposv(matrix.T, right)
    return np.linalg.solve(matrix, right) if failed else solution


def is_positive(matrices: Floats) -> Mask:
    """Mask (n,) of the symmetric matrices (n, d, d) that are positive definite: all pivots are."""
    left = np.ascontiguousarray(matrices.transpose(1, 2, 0))
    positive = np.ones(len(matrices), dtype=np.bool_)
    while len(left):
        pivot, row = left[0, 0], left[0, 1:]
        positive &= pivot > 0
        # Once a pivot is not positive, the rest of a matrix does not matter.
        row = row * positive
        left = left[1:, 1:] - row[:, None] * (row / np.where(positive, pivot, 1))
    return positive
