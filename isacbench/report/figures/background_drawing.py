"""Background drawing: a process that draws what plugins show of themselves, where they can do no harm.

It starts while a run is busy elsewhere, and has imported what it needs by the
time that it is asked.
"""

from __future__ import annotations

import warnings
from concurrent.futures import ThreadPoolExecutor
from threading import Thread
from typing import TYPE_CHECKING, Self

from isacbench.bench.workers.guarded_process import GuardedProcess, ProcessLostError
from isacbench.errors import InputWarning
from isacbench.plugins.discovery import local_plugins, register_plugin

if TYPE_CHECKING:
    from pathlib import Path
    from types import TracebackType

    from isacbench.plugins.local_files import PluginFile

TIMEOUT_S = 120.0
"""More than any diagnosis of one image takes, unless it hangs."""


class BackgroundDrawing:
    """A process that draws diagnoses; a context manager."""

    def __init__(self) -> None:
        self._process = GuardedProcess(_start, local_plugins())
        self._thread = ThreadPoolExecutor(1)
        self._is_ready = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.stop()
        self._thread.shutdown()

    def get_ready(self) -> None:
        """Start the process and have it import, and this one likewise, without waiting for either."""
        if not self._is_ready:
            self._is_ready = True
            self._process.start()
            Thread(target=_import_drawing, daemon=True).start()

    def draw_run(self, folder: Path) -> list[Path]:
        """Draw a run as `isacbench.report.figures.run_figures.draw_run` does, in two processes.

        Parameters
        ----------
        folder : Path

        Returns
        -------
        list of Path

        Warns
        -----
        InputWarning
            As there; also if a plugin's diagnosis hangs or ends its process.
        """
        from isacbench.report.figures.run_figures import draw_run

        diagnoses = self._thread.submit(self._process.call, _draw_diagnoses, folder, timeout_s=TIMEOUT_S)
        figures = draw_run(folder, with_diagnoses=False)
        try:
            more, messages = diagnoses.result()
        except ProcessLostError as loss:
            more, messages = [], [f"no maps and no spectra: {loss.reason}"]
        for message in messages:
            warnings.warn(message, InputWarning, stacklevel=2)
        return figures + more


def _import_drawing() -> None:
    from isacbench.report.figures import run_figures  # noqa: F401, importing is all


# What follows runs in the process that draws.


def _start(plugins: tuple[PluginFile, ...]) -> None:
    for plugin in plugins:
        register_plugin(plugin)
    _import_drawing()


def _draw_diagnoses(folder: Path) -> tuple[list[Path], list[str]]:
    from isacbench.report.figures.run_figures import draw_diagnoses

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", InputWarning)
        drawn = draw_diagnoses(folder)
    return drawn, [str(warning.message) for warning in caught if issubclass(warning.category, InputWarning)]
