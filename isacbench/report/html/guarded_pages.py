"""Page of a run; what plugins take part in is done by a process that may hang or die."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

from isacbench.bench.store.run_store import read_manifest
from isacbench.bench.workers.guarded_process import GuardedProcess, ProcessLostError
from isacbench.errors import InputError, InputWarning
from isacbench.plugins.discovery import local_plugins, register_plugin
from isacbench.plugins.registry import distribution, estimator_names

if TYPE_CHECKING:
    from pathlib import Path

    from isacbench.plugins.discovery import PluginFile

OWN = "isacbench"
"""Distribution of the built-in estimators."""

TIMEOUT_S = 120.0
"""More than any diagnosis of one image takes, unless it hangs."""


def draw_run_and_page(folder: Path, with_page: bool = True) -> list[Path]:
    """Draw a run as `isacbench.report.figures.run_figures.draw_run` does, and write its page.

    Parameters
    ----------
    folder : Path
        Folder of a run.
    with_page : bool
        Whether to write the page, if the run has cells.

    Returns
    -------
    list of Path
        Figures and page.

    Warns
    -----
    InputWarning
        As `write_page_guarded` warns; also if the page cannot be written.
    """
    from isacbench.report.figures.run_figures import draw_run

    written = draw_run(folder)
    if with_page and written:
        try:
            written.append(write_page_guarded(folder))
        except InputError as error:  # tables and figures are there all the same
            warnings.warn(f"no page: {error}", InputWarning, stacklevel=2)
    return written


def write_page_guarded(folder: Path) -> Path:
    """Write the page of a run. Maps of others' estimators are computed by another process.

    Parameters
    ----------
    folder : Path
        Folder of a run.

    Returns
    -------
    Path

    Warns
    -----
    InputWarning
        If a plugin's diagnosis fails, hangs or ends its process.
    """
    from isacbench.report.html.diagnosed_maps import diagnosed_maps
    from isacbench.report.html.joined_runs import read_for_page
    from isacbench.report.html.written_pages import write_run_page

    if _has_only_own_estimators(folder):
        run = read_for_page(folder)
        return write_run_page(folder, diagnosed_maps(run), run)
    with GuardedProcess(_start, local_plugins()) as process:
        try:
            maps, messages = process.call(_find_maps, folder, timeout_s=TIMEOUT_S)
        except ProcessLostError as loss:
            maps, messages = None, [f"no maps in the page: {loss.reason}"]
    for message in messages:
        warnings.warn(message, InputWarning, stacklevel=2)
    return write_run_page(folder, maps)


def _has_only_own_estimators(folder: Path) -> bool:
    """Tell whether isacbench itself brings all estimators of a run, which need no guard."""
    names = {estimator["name"] for estimator in read_manifest(folder).get("estimators", ())}
    if not names <= set(estimator_names()):
        return False
    return all(distribution("estimator", name).partition(" ")[0] == OWN for name in names)


def _start(plugins: tuple[PluginFile, ...]) -> None:
    for plugin in plugins:
        register_plugin(plugin)


def _find_maps(folder: Path) -> tuple[Any, list[str]]:
    from isacbench.report.html.diagnosed_maps import diagnosed_maps
    from isacbench.report.html.joined_runs import read_for_page

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", InputWarning)
        maps = diagnosed_maps(read_for_page(folder))
    return maps, [str(warning.message) for warning in caught if issubclass(warning.category, InputWarning)]
