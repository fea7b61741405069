"""SIGTERM of job schedulers, containers and CI: it ends a command as Ctrl-C does."""

from __future__ import annotations

import os
import signal
import threading
import time
from typing import TYPE_CHECKING, NoReturn, Self

from isacbench.cli.app import EXIT_INTERRUPTED, EXIT_TERMINATED, fail

if TYPE_CHECKING:
    from types import FrameType, TracebackType

SAME_S = 1.0
"""Signals within this time count as one: GNU timeout signals a process and then its group."""


class Termination:
    """SIGTERM while a command runs; a context manager.

    The first signal raises KeyboardInterrupt in the main thread, so that the
    command can write what it has. A later one ends the process at once.
    Handlers installed by other code, before or meanwhile, stay.
    """

    def __init__(self) -> None:
        self._first_s: float | None = None

    def __enter__(self) -> Self:
        in_main_thread = threading.current_thread() is threading.main_thread()
        if in_main_thread and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
            signal.signal(signal.SIGTERM, self._receive)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if signal.getsignal(signal.SIGTERM) == self._receive:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)

    def fail(self, message: str) -> NoReturn:
        """End the command with a message that names the interrupt: SIGTERM if received, otherwise Ctrl-C."""
        if self._first_s is None:
            fail(f"interrupted: {message}", EXIT_INTERRUPTED)
        fail(f"terminated: {message}", EXIT_TERMINATED)

    def _receive(self, number: int, frame: FrameType | None) -> None:
        now_s = time.monotonic()
        if self._first_s is None:
            self._first_s = now_s
            raise KeyboardInterrupt
        if now_s - self._first_s > SAME_S:
            os._exit(EXIT_TERMINATED)
