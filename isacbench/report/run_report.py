"""The report of a run: its tables, its figures and its page."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

from isacbench.errors import InputError, InputWarning
from isacbench.report.figures.run_figures import draw_run
from isacbench.report.html.written_pages import write_run_page
from isacbench.report.run_tables import write_run_tables

if TYPE_CHECKING:
    from pathlib import Path

    from isacbench.bench.store.run import Run
    from isacbench.charts import Table


def write_report(run: Run, with_page: bool = True) -> tuple[list[Path], list[Table]]:
    """Write tables, figures and page of a run into its folder; return the files and the tables."""
    written, tables = write_run_tables(run)
    return [*written, *draw_with_page(run, with_page)], tables


def draw_with_page(run: Run, with_page: bool = True) -> list[Path]:
    """Draw a run and write its page; warn where there can be none, for the figures are there all the same."""
    written = draw_run(run)
    if with_page and not run.rows.empty:
        try:
            written.append(write_run_page(run))
        except InputError as error:
            warnings.warn(f"no page: {error}", InputWarning, stacklevel=2)
    return written
