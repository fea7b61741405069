"""The figures of a run: charts of its kind of suite, and its images."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.bench.cells.record import CLOUD_KEYS
from isacbench.bench.cells.statuses import failed
from isacbench.bench.kinds.kind import lines_of
from isacbench.bench.kinds.population import scene_cells
from isacbench.bench.kinds.scores import MANY_SCENARIOS
from isacbench.bench.store.run import CellKey
from isacbench.bench.suites.suite_kinds import KINDS
from isacbench.charts import Axis, Chart, ChartGroup, Series, batched, nearest_values, rows_of, with_symbol
from isacbench.errors import InputWarning
from isacbench.files.checked_files import make_own_folder, require_picture
from isacbench.files.escaping import counted
from isacbench.files.file_names import file_stems
from isacbench.metrics.geometry import CloudPair
from isacbench.metrics.one_to_one import Curve, score_curve
from isacbench.metrics.paper import PROJECTIONS
from isacbench.model.cloud import PointCloud
from isacbench.report.drawing.chart_figures import draw_charts
from isacbench.report.drawing.style import drawable, save, styled
from isacbench.report.figures.cloud_figures import Image, draw_clouds, draw_comparison

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence

    import pandas as pd
    from matplotlib.figure import Figure

    from isacbench.bench.store.run import Run
    from isacbench.charts import Line, Variant

    NamedFigure = tuple[str, Figure]

FOLDER = "figures"
CLOUD_SNRS_DB = -20.0, -5.0, 10.0
CLOUDS_A_FIGURE = 4
CELL = ["estimator", "params", "snr_db"]
MOST_CLOUDS = 16
"""Most estimators of which clouds, maps and spectra are shown; of more, those of least mean deviation."""

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


def best_variants(rows: pd.DataFrame, candidates: Sequence[Variant]) -> list[Variant]:
    """Choose the estimators of a scenario whose clouds are drawn: those of least mean deviation."""
    if len(candidates) <= MOST_CLOUDS:
        return list(candidates)
    means = rows.groupby(["estimator", "params"], sort=False)["deviation"].mean()
    # What failed throughout has no mean, and comes last.
    best = set(means.reindex(list(candidates)).sort_values(kind="stable").index[:MOST_CLOUDS])
    return [variant for variant in candidates if variant in best]


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
