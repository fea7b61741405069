"""A process that draws beside this one, and is made ready while the cells of a run are computed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from threading import Event
from typing import Self

from isacbench.bench.cells.process import GuardedProcess, ProcessLostError

START_S = 1.5
"""Age of a run at which the process is started: figures of a shorter one are drawn as soon without it."""


class DrawingProcess(GuardedProcess):
    """Process around a run and its report, for which it and this one import a module meanwhile."""

    def __init__(self, module: str) -> None:
        super().__init__(_import, module)
        self._module, self._is_due = module, Event()
        self._thread = ThreadPoolExecutor(1)

    def __enter__(self) -> Self:
        self._thread.submit(self._prepare)
        return self

    def __exit__(self, *_: object) -> None:
        self._is_due.set()
        self.stop()
        self._thread.shutdown()

    def share(self, function: Callable[..., object], calls: Iterable[tuple[object, ...]]) -> None:
        """Call a function with all arguments of a list, some here, others in the process if it is ready."""
        todo, lost = iter(list(calls)), []

        def call_there() -> None:
            for arguments in todo if self.has_begun else ():
                try:
                    self.call(function, *arguments)
                except ProcessLostError:
                    lost.append(arguments)

        self._is_due.set()
        there = self._thread.submit(call_there)
        try:
            for arguments in todo:
                function(*arguments)
            there.result()
        except BaseException:
            self.stop()
            raise
        for arguments in lost:
            function(*arguments)

    def _prepare(self) -> None:
        if not self._is_due.wait(START_S):
            _import(self._module)
            self.call(_import, self._module)  # where this fails, all is drawn here


def _import(module: str) -> None:
    import_module(module)
