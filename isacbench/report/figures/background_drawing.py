"""Figures of a run, with those that plugins take part in drawn by a process that may hang or die."""

from __future__ import annotations

import warnings
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

from isacbench.bench.workers.guarded_process import GuardedProcess, ProcessLostError
from isacbench.errors import InputWarning
from isacbench.plugins.discovery import local_plugins, register_plugin

if TYPE_CHECKING:
    from pathlib import Path

    from isacbench.plugins.local_files import PluginFile

TIMEOUT_S = 120.0
"""More than any diagnosis of one image takes, unless it hangs."""


def draw_run_guarded(folder: Path) -> list[Path]:
    """Draw a run as `isacbench.report.figures.run_figures.draw_run` does, in two processes.

    Parameters
    ----------
    folder : Path
        Folder of a run.

    Returns
    -------
    list of Path
        Figures that were written.

    Warns
    -----
    InputWarning
        As there; also if a plugin's diagnosis hangs or ends its process.
    """
    from isacbench.report.figures.run_figures import draw_run

    with GuardedProcess(_start, local_plugins()) as process, ThreadPoolExecutor(1) as thread:
        diagnoses = thread.submit(process.call, _draw_diagnoses, folder, timeout_s=TIMEOUT_S)
        figures = draw_run(folder, with_diagnoses=False)
        try:
            more, messages = diagnoses.result()
        except ProcessLostError as loss:
            more, messages = [], [f"no maps and no spectra: {loss.reason}"]
    for message in messages:
        warnings.warn(message, InputWarning, stacklevel=2)
    return figures + more


def _start(plugins: tuple[PluginFile, ...]) -> None:
    for plugin in plugins:
        register_plugin(plugin)


def _draw_diagnoses(folder: Path) -> tuple[list[Path], list[str]]:
    from isacbench.report.figures.run_figures import draw_diagnoses

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", InputWarning)
        drawn = draw_diagnoses(folder)
    return drawn, [str(warning.message) for warning in caught if issubclass(warning.category, InputWarning)]
