"""Isolation of plugins in one process: changes of the process are undone, changes of data are noticed.

It guards against accidents only: a library that a plugin patches stays patched.
"""

from __future__ import annotations

import hashlib
import os
import random
import signal
import sys
import threading
import warnings
import zlib
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.cores import one_blas_thread

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray


@contextmanager
def process_state_kept() -> Iterator[None]:
    """Undo what the code within changes about this process.

    Restored are the working directory, environment, NumPy's error handling and
    print options, filters of warnings, import path, standard streams, recursion limit,
    global random generators, and the threads of BLAS, of which it has one within. In
    the main thread also signal handlers and the alarm timer.
    """
    with one_blas_thread(), ExitStack() as stack:
        for state in (warnings.catch_warnings(), np.errstate(), np.printoptions(), _signals_kept()):
            stack.enter_context(state)
        for name in ("stdin", "stdout", "stderr"):
            stack.callback(setattr, sys, name, getattr(sys, name))
        stack.callback(os.chdir, os.getcwd())  # noqa: PTH109, a text is all that is needed
        stack.callback(_set_environment, dict(os.environ))
        stack.callback(sys.path.__setitem__, slice(None), list(sys.path))
        stack.callback(random.setstate, random.getstate())
        stack.callback(np.random.set_state, np.random.get_state())  # noqa: NPY002, plugins may use it
        stack.callback(sys.setrecursionlimit, sys.getrecursionlimit())
        yield


def seed_global_generators(*key: object) -> None:
    """Seed the global random generators, so that a plugin that uses them gives the same on every machine.

    Parameters
    ----------
    *key : object
        Values on whose ``repr`` the numbers depend.
    """
    seed = zlib.crc32(repr(key).encode())
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002, a plugin may use the global one


def array_digest(array: NDArray[Any]) -> str:
    """Digest of an array that shows whether the array has changed.

    It consists of the sums of columns over the first and the second half of
    the rows. A changed bit changes it, and so do changed signs and a reversed
    order; rows that change places within a half do not. It takes a tenth of the
    time of a checksum.

    Parameters
    ----------
    array : ndarray
        Not empty, items of a multiple of 8 bytes.

    Returns
    -------
    str
        Hexadecimal digits.
    """
    words = np.ascontiguousarray(array).view(np.uint64)
    table = words.reshape(len(words), -1)
    total = hashlib.sha256(repr((array.shape, array.dtype.str)).encode())
    # A half of odd length: sign changes of an even number of rows can cancel.
    cut = len(table) // 2 | 1
    for half in (table[:cut], table[cut:]):
        total.update(half.sum(axis=0, dtype=np.uint64).tobytes())
    return total.hexdigest()


@contextmanager
def _signals_kept() -> Iterator[None]:
    """Restore signal handlers and stop an alarm that code within has set; only the main thread has them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    # A handler that Python did not install is None, and cannot be restored.
    handlers = {number: signal.getsignal(number) for number in signal.valid_signals()}
    has_alarm = signal.getitimer(signal.ITIMER_REAL)[0] > 0
    try:
        yield
    finally:
        if not has_alarm:
            signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in handlers.items():
            if handler is not None and signal.getsignal(number) is not handler:
                signal.signal(number, handler)


def _set_environment(environment: dict[str, str]) -> None:
    if os.environ != environment:
        os.environ.clear()
        os.environ.update(environment)
