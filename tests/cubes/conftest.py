"""What tests of cubes run over."""

import numpy as np
import pytest


@pytest.fixture(params=[np.complex64, np.complex128], ids=["complex64", "complex128"])
def dtype(request):
    return np.dtype(request.param)


@pytest.fixture(params=["C", "F"])
def order(request):
    return request.param
