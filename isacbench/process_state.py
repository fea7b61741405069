"""State of the process that plugins run in: what one has changed is undone before another runs."""

from __future__ import annotations

import decimal
import gc
import locale
import logging
import os
import random
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from types import ModuleType
from typing import TYPE_CHECKING, Any

from isacbench.streams import lent_streams

if TYPE_CHECKING:
    from collections.abc import Iterator

LIBRARIES = (
    "numpy",
    "scipy",
    "isacbench",
    "isacbench_algorithms",
    "builtins",
    "random",
    "math",
    "time",
    "gc",
)
"""Packages whose functions and classes are put back in place."""

OWN = "isacbench"

REPLACED = float, int, str, tuple, property, staticmethod, classmethod
"""Types of members that are put back, besides what can be called."""

Setting = tuple[Callable[[], Any], Callable[[Any], object]]


def _umask() -> int:
    """Mask of new files, which can only be read by setting it."""
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def _add_finders(finders: list[Any]) -> None:
    """Put finders of modules back that were taken away; modules that are imported later need new ones."""
    sys.meta_path[:] = [*finders, *(one for one in sys.meta_path if one not in finders)]


def _set_environment(environment: dict[str, str]) -> None:
    os.environ.clear()
    os.environ.update(environment)
    time.tzset()


FFT_MODULES = "scipy._lib.uarray", "scipy.fft._pocketfft.helper"
"""Modules that keep the backends of SciPy's FFT, and its number of workers."""


def _fft_settings() -> tuple[dict[str, Any], dict[str, Any]]:
    """Backends of SciPy's FFT for the whole process, and its number of workers, if it is loaded."""
    backends: Any
    helper: Any
    backends, helper = map(sys.modules.get, FFT_MODULES)
    try:
        return backends.get_state()._pickle()[0], dict(vars(helper._config))
    except AttributeError:  # it is not loaded, or keeps them elsewhere: they are SciPy's own affair
        return {}, {}


def _set_fft(settings: tuple[dict[str, Any], dict[str, Any]]) -> None:
    # Not by uarray's set_state: a backend that is left after it crashes the process.
    backends, helper = (sys.modules[name] for name in FFT_MODULES)
    for domain, (chosen, registered, is_last) in settings[0].items():
        backends.clear_backends(domain)
        for one in registered:
            backends.register_backend(one)
        backends.set_global_backend(*chosen, try_last=is_last)
    vars(helper._config).clear()
    vars(helper._config).update(settings[1])


OUTER: list[Setting] = [
    (lambda: dict(os.environ), _set_environment),
    (lambda: list(sys.path), lambda path: sys.path.__setitem__(slice(None), path)),
    (lambda: logging.root.level, logging.root.setLevel),
    (lambda: list(logging.root.handlers), lambda kept: logging.root.handlers.__setitem__(slice(None), kept)),
]
"""Settings that a module may make for its later use when it is imported."""

INNER: list[Setting] = [
    (os.getcwd, os.chdir),
    (_umask, os.umask),
    (gc.isenabled, lambda is_on: gc.enable() if is_on else gc.disable()),
    (gc.get_threshold, lambda threshold: gc.set_threshold(*threshold)),
    (random.getstate, random.setstate),
    (sys.getrecursionlimit, sys.setrecursionlimit),
    (sys.getswitchinterval, sys.setswitchinterval),
    (sys.gettrace, sys.settrace),
    (sys.getprofile, sys.setprofile),
    (threading.gettrace, threading.settrace),
    (threading.getprofile, threading.setprofile),
    (lambda: list(sys.argv), lambda arguments: sys.argv.__setitem__(slice(None), arguments)),
    (lambda: sys.excepthook, lambda hook: setattr(sys, "excepthook", hook)),
    (lambda: sys.displayhook, lambda hook: setattr(sys, "displayhook", hook)),
    (lambda: threading.excepthook, lambda hook: setattr(threading, "excepthook", hook)),
    (lambda: list(sys.meta_path), _add_finders),
    (_fft_settings, _set_fft),
    (lambda: logging.root.manager.disable, logging.disable),
    (lambda: locale.setlocale(locale.LC_ALL), lambda name: locale.setlocale(locale.LC_ALL, name)),
]
if sys.platform != "win32":
    import resource

    INNER.append(
        (
            partial(signal.pthread_sigmask, signal.SIG_BLOCK, ()),
            partial(signal.pthread_sigmask, signal.SIG_SETMASK),
        )
    )

    _LIMITS = [getattr(resource, name) for name in dir(resource) if name.startswith("RLIMIT_")]
    INNER += [
        (partial(resource.getrlimit, limit), partial(resource.setrlimit, limit))
        for limit in dict.fromkeys(_LIMITS)
    ]
    INNER.append((partial(os.getpriority, os.PRIO_PROCESS, 0), partial(os.setpriority, os.PRIO_PROCESS, 0)))
if hasattr(os, "sched_getaffinity"):
    INNER.append((partial(os.sched_getaffinity, 0), partial(os.sched_setaffinity, 0)))


_alone = threading.RLock()
"""Held by the thread whose changes are to be undone: those of another one could not be told from them."""


def _after_fork() -> None:
    global _alone
    _alone = threading.RLock()


if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_after_fork)


@contextmanager
def process_state_kept(at_import: bool = False) -> Iterator[None]:
    """Undo what the code within changes about this process, where a process may undo it.

    Standard streams are lent. Restored are NumPy's error handling, print options and
    generator, filters of warnings, signal handlers and the alarm timer in the main thread,
    and what `INNER` and `OUTER` list.

    Parameters
    ----------
    at_import : bool
        Whether the code within imports a plugin, which may set the environment, the path and the root logger.

    Yields
    ------
    None
    """
    import numpy as np

    settings = INNER if at_import else [*OUTER, *INNER]
    states = (
        *(warnings.catch_warnings(), np.errstate(), np.printoptions(), decimal.localcontext()),
        *(_signals_kept(), lent_streams()),
    )
    with _alone, ExitStack() as stack:
        stack.callback(np.random.set_state, np.random.get_state())  # noqa: NPY002, plugins may use it
        stack.callback(_put_modules_back, dict(sys.modules))
        for read, write in settings:
            with suppress(OSError):  # a folder that is gone
                stack.callback(_restore, read, write, read())
        for state in states:
            stack.enter_context(state)
        yield


def _restore(read: Callable[[], Any], write: Callable[[Any], object], before: Any) -> None:
    with suppress(OSError, ValueError):  # not everything can be undone, such as a lower priority
        if read() != before:
            write(before)


def _put_modules_back(before: dict[str, ModuleType]) -> None:
    """Undo that modules were replaced or taken away; what was imported meanwhile stays."""
    for name, module in before.items():
        if sys.modules.get(name) is not module:
            sys.modules[name] = module


@contextmanager
def libraries_kept() -> Iterator[None]:
    """Put functions, classes, methods and constants of `LIBRARIES` back that the code within has replaced."""
    owners: list[Any] = []
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] in LIBRARIES and "._" not in name:
            owners.append(module)
            if name.startswith(OWN):
                owners += [one for one in vars(module).values() if getattr(one, "__module__", "") == name]
    owners = [one for one in owners if isinstance(one, (ModuleType, type))]
    before = [
        (owner, name, value)
        for owner in owners
        for name, value in list(vars(owner).items())
        if callable(value) or isinstance(value, REPLACED)
    ]
    try:
        yield
    finally:
        for owner, name, value in before:
            if vars(owner).get(name) is not value:
                setattr(owner, name, value)


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
