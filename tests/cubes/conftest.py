"""What tests of cubes run over."""

import numpy as np
import pytest

from ..files.mat_readers import mat_files_read_as_by_users, mat_files_read_in_forks  # noqa: F401


@pytest.fixture(params=[np.complex64, np.complex128], ids=["complex64", "complex128"])
def dtype(request):
    return np.dtype(request.param)


@pytest.fixture(params=["C", "F"])
def order(request):
    return request.param
