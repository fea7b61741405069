import numpy as np
import pytest

from isacbench.dsp.positive_matrices import (
    is_positive,
    root_of_inverse,
    roots_of_inverses,
    solve_positive,
)


@pytest.mark.parametrize("size", [1, 2, 15, 16, 17, 50, 99])
def test_inverses_are_those_of_elimination(size):
    rng = np.random.default_rng(size)
    data = rng.standard_normal((3, size, 2 * size))
    matrices = data @ data.transpose(0, 2, 1) + np.eye(size)
    roots = roots_of_inverses(matrices.copy())
    np.testing.assert_array_equal(roots, np.triu(roots))
    inverses = roots @ roots.transpose(0, 2, 1)
    np.testing.assert_allclose(inverses @ matrices, np.tile(np.eye(size), (3, 1, 1)), atol=1e-12)
    np.testing.assert_array_equal(root_of_inverse(matrices[0], 0.0), roots[0])


def test_of_no_rows_the_root_has_none_and_lapack_prints_no_complaint(capfd):
    assert root_of_inverse(np.empty((0, 0)), 0.0).shape == (0, 0)
    assert capfd.readouterr() == ("", "")


def test_indefinite_matrices_are_solved_all_the_same_but_have_no_real_roots_unless_they_are_raised():
    matrix = np.array([[1.0, 2.0], [2.0, 1.0]])
    with pytest.raises(np.linalg.LinAlgError):
        roots_of_inverses(matrix[None].copy())
    root = root_of_inverse(matrix, 0.5)
    # Of the eigenvalues 3 and -1 the second counts as 0.5.
    np.testing.assert_allclose(root @ root.T, np.linalg.inv(matrix + 0.75 * np.array([[1, -1], [-1, 1]])))
    np.testing.assert_allclose(matrix @ solve_positive(matrix, np.array([3.0, 0.0])), [3, 0], atol=1e-15)


@pytest.mark.parametrize("size", [1, 2, 12])
def test_positive_definite_matrices_are_those_of_positive_eigenvalues(size):
    rng = np.random.default_rng(size)
    data = rng.standard_normal((50, size, size))
    matrices = data @ data.transpose(0, 2, 1) - rng.uniform(0, 0.3, (50, 1, 1)) * np.eye(size)
    expected = np.linalg.eigvalsh(matrices)[:, 0] > 0
    assert 0 < expected.sum() < 50
    np.testing.assert_array_equal(is_positive(matrices), expected)
