"""Inverses and equations of symmetric positive definite matrices, by Cholesky factors.

One matrix after the other where LAPACK is faster than numpy, which makes a general inverse of a triangle.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv, dpotrf, dtrtri

from isacbench.checked_arrays import Floats, Mask

SMALL = 24
"""Rows up to which LAPACK inverts a triangle as fast as products of its blocks do."""


def roots_of_inverses(matrices: Floats) -> Floats:
    """Upper triangular roots W of inverses W Wᵀ of matrices (n, d, d), which are overwritten."""
    matrices = np.ascontiguousarray(matrices, dtype=np.float64)
    if not matrices.size:
        return matrices  # LAPACK would print that it refuses them
    for matrix in matrices:
        # Transposed, the order of LAPACK, in which it writes over its argument.
        if dpotrf(matrix.T, lower=1, overwrite_a=1)[1]:
            raise np.linalg.LinAlgError("a matrix is not positive definite")
    _invert_upper(matrices)
    return matrices


def _invert_upper(factors: Floats) -> None:
    """Overwrite upper triangular matrices (n, d, d) by their inverses, by halves."""
    if (size := factors.shape[1]) <= SMALL:
        for factor in factors:
            factor[:] = dtrtri(factor.T, lower=1)[0].T
        return
    half = size // 2
    first, second, between = factors[:, :half, :half], factors[:, half:, half:], factors[:, :half, half:]
    _invert_upper(first)
    _invert_upper(second)
    np.matmul(first, -between @ second, out=between)


def root_of_inverse(matrix: Floats, least: float) -> Floats:
    """Root W of the inverse W Wᵀ of one matrix (d, d).

    Where rounding leaves it indefinite, eigenvalues count as `least` at least.
    """
    try:
        return roots_of_inverses(matrix[None].copy())[0]
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(matrix)
        return vectors / np.sqrt(np.maximum(values, least))


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
