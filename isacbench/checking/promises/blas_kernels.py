"""Images under other BLAS kernels, each in a process of its own.

OpenBLAS brings a set of routines, a kernel, for each family of processors and
picks one when it is loaded. Kernels add in different orders, so that their
results differ in the last digits. An estimator that magnifies those digits
gives another image on another machine.

The environment variable ``OPENBLAS_CORETYPE`` chooses a kernel. A processor runs
its own and those of older ones.
"""

from __future__ import annotations

import atexit
import os
import platform
import subprocess
import sys
from multiprocessing import Pipe
from multiprocessing.connection import Connection

from isacbench.bench.cells.cell import raw_cloud
from isacbench.cores import one_blas_thread
from isacbench.model.cloud import PointCloud
from isacbench.model.observation import Observation
from isacbench.plugins.contracts import Estimator
from isacbench.plugins.discovery import local_plugins, register_plugin
from isacbench.plugins.instances import Instances

CHOICE = "OPENBLAS_CORETYPE"

CORE_TYPES = {
    "x86_64": ("Prescott", "Nehalem", "Sandybridge", "Haswell", "Zen", "SkylakeX", "Cooperlake"),
    "aarch64": ("ARMV8", "CORTEXA57", "NEOVERSEN1", "NEOVERSEV1"),
}
"""Names that OpenBLAS takes, by machine; several may stand for one kernel."""

PROBE = """
import numpy as np
from threadpoolctl import threadpool_info
for dtype in (np.float32, np.float64, np.complex64, np.complex128):
    square = np.eye(64, dtype=dtype) + 1
    np.linalg.eigh(square), np.linalg.qr(square @ square), np.linalg.solve(square, square)
print("+".join(one["architecture"] for one in threadpool_info() if one["internal_api"] == "openblas"))
"""
"""Program that prints its kernel; it crashes if the processor lacks the kernel's instructions."""

PROBE_S = 60.0

ASKED = "asked"
"""Key of the estimator in a request."""

_known: dict[str, str] | None = None


def other_kernels() -> dict[str, str]:
    """Find the kernels that this processor can run, without its default kernel.

    The search starts one process per kernel, and is made only once.

    Returns
    -------
    dict of str to str
        Name of each kernel, and the value of ``OPENBLAS_CORETYPE`` that chooses it. Empty where the
        BLAS is not OpenBLAS.
    """
    if _known is None:
        set_kernels(_found())
        return other_kernels()
    return _known


def set_kernels(kernels: dict[str, str]) -> None:
    """Set the result of `other_kernels`, so that this process need not search.

    Parameters
    ----------
    kernels : dict of str to str
    """
    global _known
    _known = kernels


def _found() -> dict[str, str]:
    own = _probed({})
    found: dict[str, str] = {}
    for core_type in CORE_TYPES.get(platform.machine(), ()) if own else ():
        name = _probed({CHOICE: core_type})
        if name not in ("", own):
            found.setdefault(name, core_type)
    return found


def _probed(choice: dict[str, str]) -> str:
    """Name of the kernel that an environment selects; empty if it does not run."""
    probe = subprocess.run(
        [sys.executable, "-c", PROBE],
        env={**os.environ, **choice},
        capture_output=True,
        text=True,
        timeout=PROBE_S,
        check=False,
    )
    return probe.stdout.strip() if probe.returncode == 0 else ""


class KernelProcess:
    """A process under another kernel, in which estimators image with one thread.

    Parameters
    ----------
    core_type : str
        Value of ``OPENBLAS_CORETYPE``; see `other_kernels`.
    """

    def __init__(self, core_type: str) -> None:
        self._connection, far_end = Pipe()
        command = f"from {__name__} import _serve; _serve({far_end.fileno()})"
        self._process = subprocess.Popen(
            [sys.executable, "-c", command],
            env={**os.environ, CHOICE: core_type},
            pass_fds=[far_end.fileno()],
            stdin=subprocess.DEVNULL,
        )
        far_end.close()

    def image(self, estimator: Estimator, observation: Observation, truth: PointCloud) -> PointCloud:
        """Image an observation in the process.

        Parameters
        ----------
        estimator : Estimator
        observation : Observation
        truth : PointCloud

        Returns
        -------
        PointCloud

        Raises
        ------
        RuntimeError
            If it fails there, with the exception in words, or if the process ends.
        """
        try:
            self._connection.send((local_plugins(), Instances({ASKED: estimator}), observation, truth))
            cloud: PointCloud | str = self._connection.recv()
        except (EOFError, ConnectionError) as error:
            raise RuntimeError(f"the process ended with code {self._process.wait()}") from error
        if isinstance(cloud, str):
            raise RuntimeError(cloud)
        return cloud

    @property
    def has_ended(self) -> bool:
        """True if the process has ended and takes no more requests."""
        return self._process.poll() is not None

    def close(self) -> None:
        """End the process."""
        self._connection.close()
        self._process.wait()


_processes: dict[str, KernelProcess] = {}


def process_under(core_type: str) -> KernelProcess:
    """Process that runs under a kernel; started at the first call, and again after it has ended.

    Parameters
    ----------
    core_type : str
        Value of ``OPENBLAS_CORETYPE``.

    Returns
    -------
    KernelProcess
        Ends with this process.
    """
    if core_type not in _processes or _processes[core_type].has_ended:
        _processes[core_type] = KernelProcess(core_type)
        atexit.register(_processes[core_type].close)
    return _processes[core_type]


# The function below runs in the process.


def _serve(descriptor: int) -> None:
    """Image the observations that come through a connection, until it is closed."""
    connection = Connection(descriptor)
    with one_blas_thread():
        while True:
            try:
                plugins, instances, observation, truth = connection.recv()
            except (EOFError, ConnectionError):
                return
            for plugin in plugins:
                register_plugin(plugin)
            try:
                connection.send(raw_cloud(instances[ASKED], observation, truth))
            except Exception as error:  # of the plugin: the caller reports it
                connection.send(f"{type(error).__name__}: {error}")
