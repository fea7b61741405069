"""Figures for a paper: one score, or the images of one scenario, SNR and trial."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from isacbench.bench.kinds.imaging import SCORE_AXES, score_charts
from isacbench.bench.kinds.kind import lines_of
from isacbench.bench.kinds.scores import MANY_SCENARIOS, averaged_columns, summarise_scores
from isacbench.bench.suites.suite_kinds import KINDS
from isacbench.charts import nearest_values
from isacbench.errors import InputError, unknown_name
from isacbench.files.file_names import file_stems
from isacbench.report.drawing.chart_figures import draw_charts
from isacbench.report.figures.diagnosed_images import diagnosis_figures
from isacbench.report.figures.run_figures import CLOUD_SNRS_DB, cloud_figures, draw_run, save_figures

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import pandas as pd

    from isacbench.bench.store.run import Run
    from isacbench.report.figures.run_figures import NamedFigure


@dataclass(frozen=True)
class FigureChoice:
    """Choice of figures of a run; None leaves it open.

    Attributes
    ----------
    scenario : str or None
    snr_db : float or None
    trial : int or None
    metric : str or None
        Score over SNR. Without it scores are drawn only if neither SNR nor trial is chosen.
    """

    scenario: str | None = None
    snr_db: float | None = None
    trial: int | None = None
    metric: str | None = None


def draw_chosen(run: Run, choice: FigureChoice, extension: str = "png") -> list[Path]:
    """Draw chosen figures of a run; an empty choice is all figures, in the format.

    Files in ``figures`` of the run: ``<metric>-*`` or ``curves-*`` of scores; ``clouds-*``, ``rdm-*`` and
    ``spectrum-*`` of images, with SNR and trial in their names. An `InputError` if the run is not of images,
    or has not what is chosen.
    """
    if choice == FigureChoice():
        return draw_run(run, extension)
    if not KINDS[run.kind].has_images:
        allowed = ", ".join(name for name, kind in KINDS.items() if kind.has_images)
        raise InputError(
            f"{run.label}: figures can be chosen of runs of the kinds {allowed}; this one is of the kind "
            f"{run.kind}"
        )
    return save_figures(run.folder, _figures(run, _chosen_rows(run, choice), choice), extension)


def _chosen_rows(run: Run, choice: FigureChoice) -> pd.DataFrame:
    """Rows of the chosen scenario; whatever else is chosen must be among them."""
    rows, names, folder = run.rows, list(run.rows["scenario"].unique()), run.label
    if choice.scenario is not None and choice.scenario not in names:
        raise InputError(f"{folder}: {unknown_name('scenario', choice.scenario, names)}")
    if choice.scenario is not None:
        rows = rows[rows["scenario"] == choice.scenario]
    elif len(names) > MANY_SCENARIOS:
        raise InputError(
            f"{folder}: {len(names)} scenarios are too many for figures of each; give --scenario"
        )
    for what, column, wanted in (("SNR in dB", "snr_db", choice.snr_db), ("trial", "trial", choice.trial)):
        values = sorted(rows[column].unique())
        if wanted is not None and wanted not in values:
            listed = ", ".join(f"{value:g}" for value in values)
            raise InputError(f"{folder}: no {what} of {wanted:g}; allowed are {listed}")
    metrics = averaged_columns(rows)
    if choice.metric is not None and choice.metric not in metrics:
        raise InputError(f"{folder}: {unknown_name('score', choice.metric, metrics)}")
    return rows


def _figures(run: Run, rows: pd.DataFrame, choice: FigureChoice) -> Iterator[NamedFigure]:
    lines = lines_of(rows)
    is_of_images = choice.snr_db is not None or choice.trial is not None
    summary = summarise_scores(rows)
    for scenario, stem in file_stems(rows["scenario"].unique()).items():
        scene, own = run.scenarios[scenario], rows[rows["scenario"] == scenario]
        part = summary[summary["scenario"] == scenario]
        if choice.metric is not None:
            group = score_charts(part, [choice.metric], f"{choice.metric}-{stem}", lines, scene)
            yield group.stem, draw_charts(group)
        elif not is_of_images:
            scores = [score for score in SCORE_AXES if f"{score}_mean" in part]
            group = score_charts(part, scores, f"curves-{stem}", lines, scene)
            yield group.stem, draw_charts(group)
        if choice.metric is not None and not is_of_images:
            continue
        trial = int(own["trial"].min()) if choice.trial is None else choice.trial
        wanted_db = CLOUD_SNRS_DB if choice.snr_db is None else [choice.snr_db]
        snrs_db = nearest_values(sorted(own["snr_db"].unique()), wanted_db)
        at = f"{stem}-{snrs_db[0]:g}dB" if choice.snr_db is not None else stem
        yield from cloud_figures(run, lines, scenario, f"clouds-{at}-trial{trial}", snrs_db, trial)
        if is_of_images:
            yield from diagnosis_figures(run, scenario, snrs_db[-1], trial)
