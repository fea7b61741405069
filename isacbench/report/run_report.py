"""The report of a run: its tables, its figures, chosen figures for papers, and its page."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.bench.cells.record import CLOUD_KEYS, failed
from isacbench.bench.kinds.imaging import SCORE_AXES, score_charts
from isacbench.bench.kinds.kind import lines_of
from isacbench.bench.kinds.population import scene_cells
from isacbench.bench.kinds.scores import MANY_SCENARIOS, averaged_columns, summarise_scores
from isacbench.bench.store.run import CellKey
from isacbench.bench.suites.suite_kinds import KINDS
from isacbench.charts import Axis, Chart, ChartGroup, Series, batched, nearest_values, rows_of, with_symbol
from isacbench.errors import InputError, InputWarning, unknown_name
from isacbench.files.checked_files import make_own_folder, require_picture
from isacbench.files.escaping import counted
from isacbench.files.file_names import file_stems
from isacbench.metrics.geometry import CloudPair
from isacbench.metrics.one_to_one import Curve, score_curve
from isacbench.metrics.paper import PROJECTIONS
from isacbench.model.cloud import PointCloud
from isacbench.report.clouds import Image, best_variants, draw_clouds, draw_comparison
from isacbench.report.diagnoses import diagnosis_figures
from isacbench.report.figures import draw_charts, drawable, save, styled
from isacbench.report.html.written_pages import write_run_page
from isacbench.report.run_tables import write_run_tables

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence

    import pandas as pd
    from matplotlib.figure import Figure

    from isacbench.bench.store.run import Run
    from isacbench.charts import Line, Table, Variant

    NamedFigure = tuple[str, Figure]


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


FOLDER = "figures"
CLOUD_SNRS_DB = -20.0, -5.0, 10.0
CLOUDS_A_FIGURE = 4
CELL = ["estimator", "params", "snr_db"]
MOST_WORST = 6
"""Most estimators whose worst scene is drawn."""

WORST_SNR_DB = 10.0
"""SNR of the pictures of worst scenes, if it was run, otherwise the nearest one."""

NOT_RUN = Image(PointCloud.empty(), "not run")
"""Cell of which an interrupted run has no row."""


def draw_run(run: Run, extension: str = "png") -> list[Path]:
    """Draw a run into ``figures`` of its folder: the charts of its kind, and images where it has them.

    Of images ``radii.png``, and for each scenario ``clouds-*.png``, more than one where the estimators are
    many, and of the 16 best alone where they are more; of a population ``worst-*.png``. Of more than 12
    scenarios no clouds. Nothing where the run holds no cells.
    """
    return [] if run.rows.empty else save_figures(run.folder, run_figures(run), extension)


def run_figures(run: Run) -> Iterator[NamedFigure]:
    """Figures of a run by the stems of their files."""
    kind = KINDS[run.kind]
    for group in kind.charts(run.rows, run.scenarios):
        yield group.stem, draw_charts(group)
    if not kind.has_images:
        return
    lines = lines_of(run.rows)
    for group in radius_charts(run, lines):
        yield group.stem, draw_charts(group)
    if kind.name == "population":
        yield from _worst_images(run, lines)
    elif run.rows["scenario"].nunique() > MANY_SCENARIOS:
        warnings.warn(
            f"of more than {MANY_SCENARIOS} scenarios only means are drawn; isacbench image -s "
            "SCENARIO -e ESTIMATOR --plot draws one",
            InputWarning,
            stacklevel=2,
        )
    else:
        yield from _clouds(run, lines)


def save_figures(folder: Path, figures: Iterable[NamedFigure], extension: str = "png") -> list[Path]:
    """Save figures by the stems of their files into ``figures`` of a run, drawn one after the other."""
    target = folder / FOLDER
    require_picture(Path(f"figure.{extension}"))
    make_own_folder(target)
    with styled():
        return [save(figure, target / f"{stem}.{extension}") for stem, figure in figures]


def radius_charts(run: Run, lines: Mapping[Variant, Line]) -> list[ChartGroup]:
    """F-score, precision and recall of matched points over the radius, first trials at the highest SNR."""
    rows = run.rows
    top_db, first = rows["snr_db"].max(), int(rows["trial"].min())
    is_drawn = (rows["snr_db"] == top_db) & (rows["trial"] == first) & ~failed(rows)
    curves: dict[Variant, list[Curve]] = {variant: [] for variant in lines}
    for place in np.flatnonzero(is_drawn).tolist():
        name, *variant = rows[["scenario", "estimator", "params"]].iloc[place]
        pair = CloudPair.of(run.scenarios[name], run.cloud_array.cloud(place))
        curves[variant[0], variant[1]].append(score_curve(pair))
    means = {variant: Curve(*np.nanmean(own, axis=0)) for variant, own in curves.items() if own}
    if not means:
        return []
    x = Axis("radius [m]", log=True)
    charts = []
    for name in ("f_score", "precision", "recall"):
        heading = name.replace("f_score", "F-score")
        series = [
            Series(
                f"{lines[variant].label}: area {mean.area:.2f}",
                mean.radius_m,
                getattr(mean, name),
                style=with_symbol(lines[variant].style, ""),
            )
            for variant, mean in means.items()
        ]
        charts.append(Chart(heading, x, Axis(heading, limits=(0.0, 1.02)), series))
    n_scenes = counted(rows.loc[is_drawn, "scenario"].nunique(), "scene")
    return [
        ChartGroup("radii", f"Points matched one to one within a radius, {top_db:g} dB, {n_scenes}", charts)
    ]


def _clouds(run: Run, lines: Mapping[Variant, Line]) -> Iterator[NamedFigure]:
    """Clouds of every scenario's first trial."""
    for scenario, stem in file_stems(run.rows["scenario"].unique()).items():
        rows = run.rows[run.rows["scenario"] == scenario]
        snrs_db = nearest_values(sorted(rows["snr_db"].unique()), CLOUD_SNRS_DB)
        yield from cloud_figures(run, lines, scenario, f"clouds-{stem}", snrs_db, int(rows["trial"].min()))


def cloud_figures(
    run: Run,
    lines: Mapping[Variant, Line],
    scenario: str,
    stem: str,
    snrs_db: Sequence[float],
    trial: int,
) -> Iterator[NamedFigure]:
    """Draw clouds of one scenario and trial, a row an SNR, a few estimators a figure."""
    # A run of references alone still has clouds to show.
    candidates = [variant for variant, line in lines.items() if not line.is_reference] or list(lines)
    shown = best_variants(run.rows[run.rows["scenario"] == scenario], candidates)
    title = drawable(scenario)
    if len(shown) < len(candidates):
        title += f", the {len(shown)} of {len(candidates)} estimators with the least mean deviation"
    images, scene = _images(run, scenario, trial), run.scenarios[scenario]
    pages = batched(shown, CLOUDS_A_FIGURE)
    for number, page in enumerate(pages, start=1):
        rows = {snr_db: [images.get((*variant, snr_db), NOT_RUN) for variant in page] for snr_db in snrs_db}
        columns = [drawable(lines[variant].label) for variant in page]
        suffix = f"-{number}" if len(pages) > 1 else ""
        heading = f"{title}, trial {trial}"
        figure = draw_clouds(heading, scene.truth, scene.region, columns, rows, scene.radius_m)
        yield f"{stem}{suffix}", figure


def _images(run: Run, scenario: str, trial: int) -> dict[Hashable, Image]:
    """Images of one trial of a scenario, by name, parameters and SNR."""
    # Numbers first: they are compared much faster than text, and leave little of it.
    places = np.flatnonzero(run.rows["trial"] == trial)
    places = places[run.rows["scenario"].iloc[places] == scenario]
    rows = run.rows.iloc[places].set_index(CELL)
    return {
        key: _image(run.cloud_array.cloud(place), row)
        for place, (key, row) in zip(places.tolist(), rows.iterrows(), strict=True)
    }


def _image(cloud: PointCloud, record: pd.Series[Any]) -> Image:
    """Cloud of one cell, and what came of it."""
    if record["status"] == "ok":
        hausdorff_m = record[[*PROJECTIONS]].sum()
        return Image(cloud, f"{counted(len(cloud), 'point')}, Hausdorff sum {hausdorff_m:.1f} m")
    return Image(cloud, "nothing detected" if record["status"] == "no_detection" else str(record["status"]))


def _worst_images(run: Run, lines: Mapping[Variant, Line]) -> Iterator[NamedFigure]:
    """Draw the scene in which each estimator has its largest ratio, beside the truth."""
    cells = scene_cells(run.rows)
    (snr_db,) = nearest_values(sorted(cells["snr_db"].unique()), [WORST_SNR_DB])
    rated = cells[cells["snr_db"] == snr_db].dropna(subset="ratio")
    chosen = [variant for variant, line in lines.items() if not line.is_reference][:MOST_WORST]
    stems = file_stems(lines[variant].label for variant in chosen)
    for variant, stem in zip(chosen, stems.values(), strict=True):
        scenes = rows_of(rated, variant)
        if scenes.empty:
            continue
        worst = scenes.iloc[scenes["ratio"].argmax()]
        cloud = run.clouds.get(CellKey(*worst[CLOUD_KEYS]), PointCloud.empty())
        scene = run.scenarios[worst["scenario"]]
        title = f"{drawable(scene.name)} at {snr_db:g} dB: the worst ratio of {counted(len(scenes), 'scene')}"
        note = f"{counted(len(cloud), 'point')}, {worst['ratio']:.1f} times the Hausdorff sum of the oracle"
        label = drawable(lines[variant].label)
        figure = draw_comparison(title, scene.truth, label, Image(cloud, note), scene.region, scene.radius_m)
        yield f"worst-{stem}", figure


@dataclass(frozen=True)
class FigureChoice:
    """Choice of figures of a run; None leaves it open.

    Attributes
    ----------
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
