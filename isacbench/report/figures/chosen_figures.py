"""Figures for a paper: one score, or the images of one scenario, SNR and trial."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from isacbench.bench.compare.scene_scores import SCENE_KINDS
from isacbench.bench.store.run_store import read_results
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

    import pandas as pd

    from isacbench.bench.cells.record import Results
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


def draw_chosen(folder: Path, choice: FigureChoice, extension: str = "png") -> list[Path]:
    """Draw chosen figures of a stored run.

    Parameters
    ----------
    folder : Path
        Of a run.
    choice : FigureChoice
        Empty: all figures, in the format.
    extension : {"png", "pdf", "svg"}

    Returns
    -------
    list of Path
        Files in ``figures`` of the run: ``<metric>-*`` or ``curves-*`` of scores; ``clouds-*``, ``rdm-*``
        and ``spectrum-*`` of images, with SNR and trial in their names.

    Raises
    ------
    InputError
        If the folder holds no run of images, or the run has not what is chosen.

    Warns
    -----
    InputWarning
        If an estimator of the run is not installed, or its diagnosis fails.
    """
    if choice == FigureChoice():
        return draw_run(folder, extension)
    results = read_results(folder)
    if results.suite.kind not in SCENE_KINDS:
        raise InputError(
            f"{folder}: figures can be chosen of runs of the kinds {', '.join(SCENE_KINDS)}; this one is of "
            f"the kind {results.suite.kind}"
        )
    records = _chosen_rows(folder, results, choice)
    results = replace(results, records=records)
    return save_figures(folder, _figures(results, choice), extension)


def _chosen_rows(folder: Path, results: Results, choice: FigureChoice) -> pd.DataFrame:
    """Rows of the chosen scenario; whatever else is chosen must be among them."""
    records, names = results.records, list(results.records["scenario"].unique())
    if choice.scenario is not None and choice.scenario not in names:
        raise InputError(f"{folder}: {unknown_name('scenario', choice.scenario, names)}")
    if choice.scenario is not None:
        records = records[records["scenario"] == choice.scenario]
    elif len(names) > MANY_SCENARIOS:
        raise InputError(
            f"{folder}: {len(names)} scenarios are too many for figures of each; give --scenario"
        )
    for what, column, wanted in (("SNR in dB", "snr_db", choice.snr_db), ("trial", "trial", choice.trial)):
        values = sorted(records[column].unique())
        if wanted is not None and wanted not in values:
            listed = ", ".join(f"{value:g}" for value in values)
            raise InputError(f"{folder}: no {what} of {wanted:g}; allowed are {listed}")
    metrics = averaged_columns(records)
    if choice.metric is not None and choice.metric not in metrics:
        raise InputError(f"{folder}: {unknown_name('score', choice.metric, metrics)}")
    return records


def _figures(results: Results, choice: FigureChoice) -> Iterator[NamedFigure]:
    records, looks = results.records, variant_looks(results.records)
    is_of_images = choice.snr_db is not None or choice.trial is not None
    summary = summarise_scores(records)
    for scenario, stem in file_stems(records["scenario"].unique()).items():
        scene, own = results.scenarios[scenario], records[records["scenario"] == scenario]
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
        yield from cloud_figures(results, looks, scenario, f"clouds-{at}-trial{trial}", snrs_db, trial)
        if is_of_images:
            yield from diagnosis_figures(results, scenario, snrs_db[-1], trial)
