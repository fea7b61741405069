"""MATLAB's files before 7.3, read in forks: a new process, as users have it, takes half a second to start."""

import faulthandler
import gc
import os
import subprocess
import sys
import warnings
from types import SimpleNamespace

import pytest

from isacbench.files.arrays import mat_files


class ForkedReader:
    """Stand-in for `subprocess.Popen` in `mat_files`: a fork runs its function and sends to pipes."""

    def __init__(self, command, **_pipes):
        *_, module, path = command
        assert module == mat_files.__name__
        (stdout, out), (stderr, err) = os.pipe(), os.pipe()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # that this process has threads
            self.pid = os.fork()
        if not self.pid:
            _send(path, out, err)
        os.close(out)
        os.close(err)
        self.stdout, self.stderr = os.fdopen(stdout, "rb"), os.fdopen(stderr, "rb")

    def wait(self):
        self.returncode = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        self.pid = None
        return self.returncode

    def __enter__(self):
        return self

    def __exit__(self, *_error):
        self.stdout.close()
        self.stderr.close()
        if self.pid:
            self.wait()


def _send(path, out, err):
    """Do what the new process does, and end without what the test's process has still to do."""
    try:
        gc.disable()
        faulthandler.disable()
        warnings.simplefilter("ignore")
        sys.stdout, sys.stderr = os.fdopen(out, "w"), os.fdopen(err, "w")
        mat_files._send_variables(path)
        sys.stdout.flush()
    except SystemExit as told:
        print(told, file=sys.stderr, flush=True)
        os._exit(1)
    finally:
        os._exit(0)


@pytest.fixture(scope="module", autouse=True)
def mat_files_read_in_forks():
    """Read the mat files of a module in forks, where a process that has threads may fork."""
    import scipy.io  # noqa: F401

    with pytest.MonkeyPatch.context() as patch:
        if sys.platform == "linux":
            patch.setattr(mat_files, "subprocess", SimpleNamespace(Popen=ForkedReader, PIPE=None))
        yield


@pytest.fixture
def mat_files_read_as_by_users(monkeypatch, mat_files_read_in_forks):
    """Read the mat files of a test in processes that are started anew."""
    monkeypatch.setattr(mat_files, "subprocess", subprocess)
