"""Processor cores that this process may use, and one thread of linear algebra for imaging."""

from __future__ import annotations

import os
import sys
from contextlib import ContextDecorator
from functools import lru_cache
from threading import RLock, get_ident
from typing import Any

_lock = RLock()
_inside: list[int] = []  # threads, each as often as it has entered
_before: dict[tuple[str, int | None], int] = {}


def available_cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class one_blas_thread(ContextDecorator):  # noqa: N801, called as a function
    """Limit of BLAS and OpenMP to one thread; a context manager, or a decorator of functions.

    Small batched algebra gains nothing from threads that wait for each other: on busy cores, images with
    two take up to a hundred times as long. The number of BLAS threads belongs to the process. It is
    limited while any thread is inside; the last one to leave restores what the first one found.
    """

    def __enter__(self) -> None:
        with _lock:
            for library in _libraries(len(sys.modules)):
                _before.setdefault(_owner(library), library.num_threads)
                _set_threads(library, 1)
            _inside.append(get_ident())

    def __exit__(self, *_: object) -> None:
        with _lock:
            _inside.remove(get_ident())
            for library in _libraries(len(sys.modules)):
                owner = _owner(library)
                if owner in _before and not (owner[1] in _inside if owner[1] else _inside):
                    _set_threads(library, _before.pop(owner))


@lru_cache(maxsize=1)
def _libraries(n_modules: int) -> Any:
    """Libraries that are loaded; looked for again when modules were imported, which may bring some."""
    import scipy.linalg  # noqa: F401  # its BLAS is not that of NumPy
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().lib_controllers


def _owner(library: Any) -> tuple[str, int | None]:
    """Owner of a number of threads: a library, or with OpenMP a library in this thread."""
    api = library.threading_layer if library.internal_api == "openblas" else library.user_api
    return library.filepath, get_ident() if api == "openmp" else None


def _set_threads(library: Any, number: int) -> None:
    """Set a number from any thread; threadpoolctl 3.8 ignores all threads but the first that has set one."""
    release = getattr(library, "clear_controlling_thread", lambda force: None)
    release(force=True)
    library.set_num_threads(number)
    release(force=True)
