"""Fixtures of the tests of promises."""

import pytest

from isacbench.checking.promises import blas_kernels


@pytest.fixture(autouse=True)
def kernels(monkeypatch):
    """Let no process start under another BLAS kernel; a test may put kernels in."""
    others = {}
    monkeypatch.setattr(blas_kernels, "_known", others)
    return others
