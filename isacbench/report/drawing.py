"""A process that draws beside this one, and is made ready while the cells of a run are computed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import suppress
from importlib import import_module
from threading import Timer
from typing import Self

from isacbench.bench.cells.process import GuardedProcess, ProcessLostError

START_S = 1.5
"""Age of a run at which the process is started: figures of a shorter one are drawn as soon without it."""


class DrawingProcess(GuardedProcess):
    """Process around a run and its report, for which it and this one import a module meanwhile."""

    def __init__(self, module: str) -> None:
        super().__init__(_import, module)
        self._start = Timer(START_S, self._prepare, [module])

    def __enter__(self) -> Self:
        self._start.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._start.cancel()
        self.stop()
        self._start.join()

    def share(self, function: Callable[..., object], calls: Iterable[tuple[object, ...]]) -> None:
        """Call a function with all arguments of a list, some here, others in the process if it is ready."""
        todo, lost = iter(list(calls)), []

        def call_there() -> None:
            for arguments in todo:
                try:
                    self.call(function, *arguments)
                except ProcessLostError:
                    lost.append(arguments)

        self._start.cancel()
        self._start.join()
        with ThreadPoolExecutor(1) as thread:
            try:
                there = thread.submit(call_there) if self.has_begun else None
                for arguments in todo:
                    function(*arguments)
                if there is not None:
                    there.result()
            except BaseException:
                self.stop()
                raise
        for arguments in lost:
            function(*arguments)

    def _prepare(self, module: str) -> None:
        _import(module)
        with suppress(CancelledError, ProcessLostError):  # nobody needs it
            self.call(_import, module)


def _import(module: str) -> None:
    import_module(module)
