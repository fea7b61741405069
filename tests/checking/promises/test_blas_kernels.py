"""Images under other BLAS kernels: the promise is kept by what does not magnify rounding, and else broken."""

import os

import pytest
from threadpoolctl import threadpool_info

from isacbench.checking.promises import blas_kernels
from isacbench.checking.promises.blas_kernels import KernelProcess, other_kernels
from isacbench.checking.promises.drift import cloud_drift
from isacbench.checking.promises.image_promises import BLAS_KERNELS, Imaging
from isacbench.checking.promises.promise import BrokenPromiseError, NotApplicableError
from isacbench.checking.promises.small_scenes import RESOLVED, observed
from isacbench.plugins.discovery import PluginFile, isolated_plugins, register_plugin
from isacbench.plugins.registry import get_estimator

SHOT = observed(RESOLVED, 40.0)

LOCAL = """
import os
from dataclasses import dataclass
from typing import ClassVar

from isacbench.model.cloud import PointCloud
from isacbench.plugins.registry import get_estimator


@dataclass(frozen=True)
class Local:
    name: ClassVar[str] = "local"
    deed: str = "none"

    def estimate(self, observation):
        print("no part of any answer")
        cloud = get_estimator("music2d").estimate(observation)
        if "OPENBLAS_CORETYPE" in os.environ:
            if self.deed == "moves":
                return PointCloud(cloud.xyz + 1e-4, cloud.velocity, cloud.power)
            if self.deed == "loses":
                return PointCloud.empty()
            if self.deed == "raises":
                raise ZeroDivisionError("no luck")
            if self.deed == "dies":
                os._exit(7)
        return cloud
"""


@pytest.fixture
def local(monkeypatch):
    """Register an estimator that goes wrong under another kernel in a chosen way, and return its builder."""
    monkeypatch.delenv("OPENBLAS_CORETYPE", raising=False)
    with isolated_plugins():
        register_plugin(PluginFile("local.py", LOCAL))
        yield lambda deed: get_estimator("local", deed=deed)


def test_kernels_are_those_that_run_here_without_that_of_this_process(monkeypatch):
    runs_here = {"": "Fourth", "Nehalem": "First", "Haswell": "Fourth", "Sandybridge": "Third"}
    monkeypatch.setattr(blas_kernels, "_known", None)
    monkeypatch.setattr(blas_kernels.platform, "machine", lambda: "x86_64")
    monkeypatch.setattr(blas_kernels, "_probed", lambda env: runs_here.get("".join(env.values()), ""))
    assert other_kernels() == {"First": "Nehalem", "Third": "Sandybridge"}
    runs_here.clear()
    assert other_kernels() == {"First": "Nehalem", "Third": "Sandybridge"}  # looked for once


def test_a_probe_names_the_kernel_that_is_chosen_and_fails_where_there_is_none(monkeypatch):
    assert blas_kernels._probed({}) == "+".join(
        one["architecture"]
        for one in threadpool_info()
        if one["internal_api"] == "openblas" and "numpy" in one["filepath"]
    )
    monkeypatch.setattr(blas_kernels, "PROBE", "import os; os.abort()")
    assert blas_kernels._probed({}) == ""


def test_another_process_under_the_kernel_of_this_one_has_the_same_image_again_and_again():
    process = KernelProcess(os.environ.get("OPENBLAS_CORETYPE", ""))
    try:
        here = Imaging(get_estimator("esprit2d"), SHOT)
        for _ in range(2):
            there = process.image(here.estimator, SHOT.observation(), SHOT.scenario.truth)
            assert cloud_drift(SHOT.scenario, here.cloud, there) < 1e-12
    finally:
        process.close()


def test_what_happens_under_one_kernel_alone_breaks_the_promise_in_words_and_else_it_is_kept(local, kernels):
    kernels["Other"] = "Nehalem"
    for estimator in (local("none"), get_estimator("music2d_joint")):
        assert BLAS_KERNELS.drift(Imaging(estimator, SHOT)) < BLAS_KERNELS.bound
    for deed, told in (
        ("loses", "under the BLAS kernel Other: 3 points, then 0"),
        ("raises", "under the BLAS kernel Other: ZeroDivisionError: no luck"),
        ("dies", "under the BLAS kernel Other: the process ended with code 7"),
    ):
        with pytest.raises(BrokenPromiseError, match=told):
            BLAS_KERNELS.drift(Imaging(local(deed), SHOT))
        # The next one is asked in a process that lives.
        assert BLAS_KERNELS.drift(Imaging(local("moves"), SHOT)) > 1e-7


def test_without_another_kernel_nothing_is_said():
    with pytest.raises(NotApplicableError):
        BLAS_KERNELS.drift(Imaging(get_estimator("music2d"), SHOT))
