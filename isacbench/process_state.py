"""State of the process that plugins share with isacbench: their changes are undone, their output is moved."""

from __future__ import annotations

import errno
import io
import os
import random
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import Any

_alone = threading.RLock()
"""Held by the thread whose changes are to be undone: those of another one could not be told from them."""


class _StandardOutput(io.FileIO):
    """Descriptor whose reader may have left, as ``head`` does, or whose disk is full: work goes on."""

    is_lost = False

    def write(self, data: Any, /) -> int:
        try:
            return super().write(data)
        except OSError as error:
            if error.errno != errno.EPIPE and not self.is_lost:
                print(f"isacbench: stdout: {error.strerror}; the rest is not printed", file=sys.stderr)
            self.is_lost = True
            return len(data)


class OwnOutput(io.TextIOWrapper):
    """Standard output of the command line; what threads of plugins print there goes to standard error."""

    thread = 0

    def write(self, text: str, /) -> int:
        """Write text, or hand it on."""
        return super().write(text) if threading.get_ident() == self.thread else sys.stderr.write(text)


@contextmanager
def own_output() -> Iterator[None]:
    """Keep standard output to what isacbench prints in this thread; all else goes to standard error.

    Descriptor 1 leads there at once, and `sys.stdout` when the block has ended.
    """
    if sys.stdout is None or sys.stderr is None:  # closed by the caller
        yield
        return
    raw = _StandardOutput(os.dup(1), "w")
    own = OwnOutput(
        io.BufferedWriter(raw),
        encoding=sys.stdout.encoding,
        errors="backslashreplace",
        line_buffering=raw.isatty(),
    )
    own.thread = threading.get_ident()
    os.dup2(2, 1)
    sys.stdout = own
    try:
        yield
    finally:
        own.close()
        sys.stdout = sys.stderr  # for what a plugin prints when the process ends


@contextmanager
def plugin_output() -> Iterator[None]:
    """Move what a plugin prints to standard error on the command line, whose own output may be JSON."""
    with redirect_stdout(sys.stderr if isinstance(sys.stdout, OwnOutput) else sys.stdout):
        yield


@contextmanager
def process_state_kept(at_import: bool = False) -> Iterator[None]:
    """Undo what the code within changes about this process.

    Put back are the working folder, the environment (not after the import of a plugin, which may set
    it for later), standard streams, filters of warnings, NumPy's error handling and print options, and
    the random generators of Python and NumPy. FFTs are SciPy's own afterwards.
    """
    import numpy as np

    with _alone, ExitStack() as stack:
        stack.callback(np.random.set_state, np.random.get_state())  # noqa: NPY002, plugins may use it
        stack.callback(random.setstate, random.getstate())
        if fft := sys.modules.get("scipy.fft"):
            stack.callback(fft.set_global_backend, "scipy")
        if not at_import:
            stack.callback(_set_environment, dict(os.environ))
        with suppress(OSError):  # a folder that is gone
            stack.callback(_set_folder, Path.cwd())
        for name in ("stdin", "stdout", "stderr"):
            stack.callback(setattr, sys, name, getattr(sys, name))
        output = redirect_stdout(sys.stderr) if at_import else plugin_output()
        for state in (warnings.catch_warnings(), np.errstate(), np.printoptions(), output):
            stack.enter_context(state)
        yield


def _set_environment(environment: dict[str, str]) -> None:
    if os.environ != environment:
        os.environ.clear()
        os.environ.update(environment)
        time.tzset()


def _set_folder(folder: Path) -> None:
    with suppress(OSError):  # it is gone now
        os.chdir(folder)
