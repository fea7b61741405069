"""One process for many plugins: what each changes about it is put back, what all share is watched.

A monkeypatched library cannot be seen, and is not: whoever wants to disturb
others on purpose, can. What happens by accident, does not reach them.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import random
import signal
import sys
import threading
import warnings
import zlib
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

STANDARD_FILES = 0, 1, 2


@contextmanager
def process_state_kept() -> Iterator[None]:
    """Put back what code within changes about this process.

    Working directory, environment, NumPy's error handling and print options,
    filters of warnings, import path, standard files and streams, recursion
    limit, global random generators, file mode mask; in the main thread also signal handlers
    and the alarm timer.
    """
    folder, environment = _working_directory(), dict(os.environ)
    import_path, streams = list(sys.path), (sys.stdin, sys.stdout, sys.stderr)
    generators = random.getstate(), np.random.get_state()  # noqa: NPY002, plugins may use the global one
    recursion_limit, mask = sys.getrecursionlimit(), _file_mode_mask()
    error_handling, print_options = np.geterr(), np.get_printoptions()
    with warnings.catch_warnings(), _signals_kept(), _standard_files_kept():
        try:
            yield
        finally:
            sys.setrecursionlimit(recursion_limit)
            if folder is not None and _working_directory() != folder:
                os.chdir(folder)
            if os.environ != environment:
                os.environ.clear()
                os.environ.update(environment)
            sys.path[:] = import_path
            sys.stdin, sys.stdout, sys.stderr = streams
            os.umask(mask)
            random.setstate(generators[0])
            np.random.set_state(generators[1])  # noqa: NPY002
            np.seterr(**error_handling)
            np.set_printoptions(**print_options)


def seed_global_generators(*key: object) -> None:
    """Seed the global random generators, so that a plugin which uses them yields the same wherever it runs.

    Parameters
    ----------
    *key : object
        What the numbers follow from, by its ``repr``.
    """
    seed = zlib.crc32(repr(key).encode())
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002, a plugin may use the global one


def array_digest(array: NDArray[Any]) -> str:
    """Digest that tells whether an array has been changed, at the speed of memory.

    Sums of columns, of the first and of the second half: every single bit
    shows, and so do other signs and another order, in a tenth of the time of a
    checksum. Enough against mishaps, not against forgery.

    Parameters
    ----------
    array : ndarray
        Not empty, items of a multiple of 8 bytes.
    """
    words = np.ascontiguousarray(array).view(np.uint64)
    table = words.reshape(len(words), -1)
    total = hashlib.sha256(repr((array.shape, array.dtype.str)).encode())
    # Halves of odd lengths: of an even number of signs that change nothing would be left.
    cut = len(table) // 2 | 1
    for half in (table[:cut], table[cut:]):
        total.update(half.sum(axis=0, dtype=np.uint64).tobytes())
    return total.hexdigest()


@contextmanager
def _signals_kept() -> Iterator[None]:
    """Put back signal handlers and end the alarm; only the main thread has them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers = {number: signal.getsignal(number) for number in signal.valid_signals()}
    has_alarm = signal.getitimer(signal.ITIMER_REAL)[0] > 0
    try:
        yield
    finally:
        if not has_alarm:
            signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in handlers.items():
            # A handler that Python did not install is None, and cannot be put back.
            if handler is not None and signal.getsignal(number) is not handler:
                signal.signal(number, handler)


@contextmanager
def _standard_files_kept() -> Iterator[None]:
    """Put back what standard input, output and error of the process lead to."""
    copies = {}
    for number in STANDARD_FILES:
        with suppress(OSError):  # a daemon may have none
            copies[number] = fcntl.fcntl(number, fcntl.F_DUPFD_CLOEXEC, len(STANDARD_FILES))
    try:
        yield
    finally:
        for number, copy in copies.items():
            os.dup2(copy, number)
            os.close(copy)


def _working_directory() -> str | None:
    """Working directory, None where it has been deleted."""
    try:
        return os.getcwd()  # noqa: PTH109, a string is all that is needed
    except FileNotFoundError:
        return None


def _file_mode_mask() -> int:
    """Mask of file modes, which can only be read by setting it."""
    mask = os.umask(0o022)
    os.umask(mask)
    return mask
