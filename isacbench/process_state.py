"""State of the process that plugins run in: what one has changed is undone before another runs."""

from __future__ import annotations

import os
import random
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from isacbench.streams import lent_streams

_alone = threading.RLock()
"""Held by the thread whose changes are to be undone: those of another one could not be told from them."""


def _after_fork() -> None:
    global _alone
    _alone = threading.RLock()


if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_after_fork)


@contextmanager
def process_state_kept(at_import: bool = False) -> Iterator[None]:
    """Undo what the code within changes about this process; standard streams are lent to it.

    Put back are the working folder, the environment (not after the import of a plugin, which may set
    it for later), filters of warnings, NumPy's error handling and print options, and the random
    generators of Python and NumPy. FFTs are SciPy's own afterwards.
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
        for state in (warnings.catch_warnings(), np.errstate(), np.printoptions(), lent_streams()):
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
