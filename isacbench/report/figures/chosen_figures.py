"""Figures for a paper: one score, or the images of one scenario, SNR and trial."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from isacbench.bench.compare.scene_scores import SCENE_KINDS
from isacbench.bench.studies.imaging_study import MANY_SCENARIOS, averaged_columns, summarise_scores
from isacbench.errors import InputError, unknown_name
from isacbench.model.radio_coordinates import median_gain_db
from isacbench.report.drawing.style import file_stems
from isacbench.report.figures.curves import draw_score, draw_scores, nearest_values, variant_looks
from isacbench.report.figures.diagnosed_images import diagnosis_figures
from isacbench.report.figures.run_figures import CLOUD_SNRS_DB, cloud_figures, draw_run, save_figures

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from isacbench.bench.store.run import Run
    from isacbench.report.figures.curves import NamedFigure


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
    """Draw chosen figures of a run; of an empty choice all, in the format.

    Files in ``figures`` of the run are ``<metric>-*`` or ``curves-*`` of scores; ``clouds-*``, ``rdm-*`` and
    ``spectrum-*`` of images, with SNR and trial in their names. InputError if it is no run of images, or has
    not what is chosen; a warning if an estimator is not installed, or its diagnosis fails.
    """
    if choice == FigureChoice():
        return draw_run(run, extension)
    if run.kind not in SCENE_KINDS:
        raise InputError(
            f"{run.label}: figures can be chosen of runs of the kinds {', '.join(SCENE_KINDS)}; this one is "
            f"of the kind {run.kind}"
        )
    chosen = _require_chosen(run, choice)
    return save_figures(run.folder, _figures(chosen, choice), extension)


def _require_chosen(run: Run, choice: FigureChoice) -> Run:
    """Take the rows of the chosen scenario; whatever else is chosen must be among them."""
    names = list(run.rows["scenario"].unique())
    if choice.scenario is not None and choice.scenario not in names:
        raise InputError(f"{run.label}: {unknown_name('scenario', choice.scenario, names)}")
    if choice.scenario is not None:
        run = run.take((run.rows["scenario"] == choice.scenario).to_numpy())
    elif len(names) > MANY_SCENARIOS:
        raise InputError(
            f"{run.label}: {len(names)} scenarios are too many for figures of each; give --scenario"
        )
    for what, column, wanted in (("SNR in dB", "snr_db", choice.snr_db), ("trial", "trial", choice.trial)):
        values = sorted(run.rows[column].unique())
        if wanted is not None and wanted not in values:
            listed = ", ".join(f"{value:g}" for value in values)
            raise InputError(f"{run.label}: no {what} of {wanted:g}; allowed are {listed}")
    metrics = averaged_columns(run.rows)
    if choice.metric is not None and choice.metric not in metrics:
        raise InputError(f"{run.label}: {unknown_name('score', choice.metric, metrics)}")
    return run


def _figures(run: Run, choice: FigureChoice) -> Iterator[NamedFigure]:
    records, looks = run.rows, variant_looks(run.rows)
    is_of_images = choice.snr_db is not None or choice.trial is not None
    summary = summarise_scores(records)
    for scenario, stem in file_stems(records["scenario"].unique()).items():
        scene, own = run.scenarios[scenario], records[records["scenario"] == scenario]
        gain_db = median_gain_db(scene)
        if choice.metric is not None:
            figure = draw_score(summary, scenario, choice.metric, looks, scene.radius_m, gain_db)
            yield f"{choice.metric}-{stem}", figure
        elif not is_of_images:
            yield f"curves-{stem}", draw_scores(summary, scenario, looks, scene.radius_m, gain_db)
        if choice.metric is not None and not is_of_images:
            continue
        trial = int(own["trial"].min()) if choice.trial is None else choice.trial
        wanted_db = CLOUD_SNRS_DB if choice.snr_db is None else [choice.snr_db]
        snrs_db = nearest_values(sorted(own["snr_db"].unique()), wanted_db)
        at = f"{stem}-{snrs_db[0]:g}dB" if choice.snr_db is not None else stem
        yield from cloud_figures(run, looks, scenario, f"clouds-{at}-trial{trial}", snrs_db, trial)
        if is_of_images:
            yield from diagnosis_figures(run, scenario, snrs_db[-1], trial)
