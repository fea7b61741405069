"""The figures of a run."""

from __future__ import annotations

import warnings
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.bench.cells.statuses import failed
from isacbench.bench.studies.imaging_study import (
    MANY_SCENARIOS,
    average_scenarios,
    summarise_scores,
)
from isacbench.bench.suites.suite_kinds import kind_of
from isacbench.errors import InputWarning
from isacbench.files.checked_files import make_own_folder, require_picture
from isacbench.files.escaping import counted
from isacbench.metrics.geometry import CloudPair
from isacbench.metrics.one_to_one import Curve, score_curve
from isacbench.metrics.paper import PROJECTIONS
from isacbench.model.cloud import PointCloud
from isacbench.model.radio_coordinates import median_gain_db
from isacbench.report.drawing.style import drawable, file_stems, save, styled
from isacbench.report.figures.cloud_figures import Image, draw_clouds
from isacbench.report.figures.curves import (
    draw_deviations,
    draw_radii,
    draw_scores,
    nearest_values,
    variant_looks,
)
from isacbench.report.figures.pareto_figures import draw_pareto, draw_stages
from isacbench.report.tables.pareto import summarise_points, timed_rows
from isacbench.report.tables.run_tables import batched, mean_of_scenarios

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence

    import pandas as pd
    from matplotlib.figure import Figure

    from isacbench.bench.plan.labels import Variant
    from isacbench.bench.store.run import Run
    from isacbench.report.drawing.style import LineLook
    from isacbench.report.figures.curves import NamedFigure

FOLDER = "figures"
CLOUD_SNRS_DB = -20.0, -5.0, 10.0
CLOUDS_A_FIGURE = 4
CELL = ["estimator", "params", "snr_db"]
MOST_CLOUDS = 16
"""Most estimators of which clouds, maps and spectra are shown; of more, those of least mean deviation."""

NOT_RUN = Image(PointCloud.empty(), "not run")
"""Cell of which an interrupted run has no record."""


def draw_run(run: Run, extension: str = "png") -> list[Path]:
    """Draw a run: of images scores over SNR and clouds; of a study its own figures.

    Figures of the same names in ``figures`` of its folder are replaced. Of images: ``deviation.png``,
    ``radii.png``; for each scenario ``curves-*.png`` and ``clouds-*.png``, more than one of these where the
    estimators are many, and of the 16 best alone where they are more; where the time counts ``pareto-*.png``
    and, where stages were timed, ``stages-*.png``; of more than 12 scenarios only ``deviation.png`` with
    their mean and ``radii.png``. Of a population ``ratios.png``, ``scores.png``, ``radii.png``,
    ``targets-*.png`` and ``worst-*.png``. Of another study, for each scenario that it has:
    ``efficiency-*.png``; ``resolution-*.png``; ``maps.png`` and ``roc.png``, and ``detection-*.png``; or
    ``link-*.png`` and ``trade-*.png``. Nothing where the run holds no cells.
    """
    draw: Callable[[Run], Iterator[NamedFigure]] = resolve_name(kind_of(run.suite).figures)
    return [] if run.rows.empty else save_figures(run.folder, draw(run), extension)


def save_figures(folder: Path, figures: Iterable[NamedFigure], extension: str = "png") -> list[Path]:
    """Save figures into ``figures`` of a run, by the stems of their files, drawn one after the other."""
    target = folder / FOLDER
    require_picture(Path(f"figure.{extension}"))
    make_own_folder(target)
    with styled():
        return [save(figure, target / f"{stem}.{extension}") for stem, figure in figures]


def imaging_figures(run: Run) -> Iterator[NamedFigure]:
    """Draw scores over SNR, run time against error where the time counts, and clouds.

    Of more than 12 scenarios only their mean deviation and times are drawn.
    """
    looks = variant_looks(run.rows)
    if _is_crowded(run):
        yield "deviation", _mean_deviation(run, looks)
        yield from radii(run, looks)
        yield from tradeoffs(run, looks)
        return
    yield from _curves(run, looks)
    yield from radii(run, looks)
    yield from tradeoffs(run, looks)
    yield from _clouds(run, looks)


def _is_crowded(run: Run) -> bool:
    """Tell whether a run has too many scenarios for figures of each."""
    return run.rows["scenario"].nunique() > MANY_SCENARIOS


def _mean_deviation(run: Run, looks: dict[Variant, LineLook]) -> Figure:
    """Deviation over SNR as a mean over scenarios, and a warning that says what is not drawn."""
    n_scenarios = run.rows["scenario"].nunique()
    warnings.warn(
        f"of more than {MANY_SCENARIOS} scenarios only means are drawn; isacbench image -s "
        "SCENARIO -e ESTIMATOR --plot draws one",
        InputWarning,
        stacklevel=2,
    )
    return draw_deviations(average_scenarios(run.rows), looks, mean_of_scenarios(n_scenarios))


def tradeoffs(run: Run, looks: Mapping[Variant, LineLook]) -> Iterator[NamedFigure]:
    """Draw time against error of every scenario, or of many together, where the time counts."""
    rows = timed_rows(run.rows)
    if rows.empty:
        return
    points = summarise_points(rows, {name for (name, _), look in looks.items() if look.is_bound})
    for scenario, stem in file_stems(points["scenario"].unique()).items():
        yield f"pareto-{stem}", draw_pareto(points, scenario)
        stages = draw_stages(rows, points, scenario)
        if stages is not None:
            yield f"stages-{stem}", stages


def _curves(run: Run, looks: dict[Variant, LineLook]) -> Iterator[NamedFigure]:
    """Scores over SNR, all scenarios together and each on its own."""
    summary = summarise_scores(run.rows)
    yield "deviation", draw_deviations(summary, looks)
    for scenario, stem in file_stems(summary["scenario"].unique()).items():
        scene = run.scenarios[scenario]
        yield (
            f"curves-{stem}",
            draw_scores(summary, scenario, looks, scene.radius_m, median_gain_db(scene)),
        )


def radii(run: Run, looks: Mapping[Variant, LineLook]) -> Iterator[NamedFigure]:
    """Draw scores of matched points over the radius, first trials at the highest SNR."""
    rows = run.rows
    top_db, first = rows["snr_db"].max(), int(rows["trial"].min())
    is_drawn = (rows["snr_db"] == top_db) & (rows["trial"] == first) & ~failed(rows)
    curves: dict[Variant, list[Curve]] = {variant: [] for variant in looks}
    for place in np.flatnonzero(is_drawn).tolist():
        name, *variant = rows[["scenario", "estimator", "params"]].iloc[place]
        pair = CloudPair.of(run.scenarios[name], run.cloud_array.cloud(place))
        curves[variant[0], variant[1]].append(score_curve(pair))
    if any(curves.values()):
        n_scenes = counted(rows.loc[is_drawn, "scenario"].nunique(), "scene")
        title = f"Points matched one to one within a radius, {top_db:g} dB, {n_scenes}"
        yield "radii", draw_radii(curves, looks, title)


def _clouds(run: Run, looks: dict[Variant, LineLook]) -> Iterator[NamedFigure]:
    """Clouds of every scenario's first trial."""
    for scenario, stem in file_stems(run.rows["scenario"].unique()).items():
        records = run.rows[run.rows["scenario"] == scenario]
        snrs_db = nearest_values(sorted(records["snr_db"].unique()), CLOUD_SNRS_DB)
        trial = int(records["trial"].min())
        yield from cloud_figures(run, looks, scenario, f"clouds-{stem}", snrs_db, trial)


def cloud_figures(
    run: Run,
    looks: Mapping[Variant, LineLook],
    scenario: str,
    stem: str,
    snrs_db: Sequence[float],
    trial: int,
) -> Iterator[NamedFigure]:
    """Draw clouds of one scenario and trial, a row an SNR, a few estimators a figure."""
    # A run of limits alone still has clouds to show.
    candidates = [variant for variant, look in looks.items() if not look.is_bound] or list(looks)
    records = run.rows[run.rows["scenario"] == scenario]
    shown = best_variants(records, candidates)
    title = drawable(scenario)
    if len(shown) < len(candidates):
        title += f", the {len(shown)} of {len(candidates)} estimators with the least mean deviation"
    images, scene = _images(run, scenario, trial), run.scenarios[scenario]
    pages = batched(shown, CLOUDS_A_FIGURE)
    for number, page in enumerate(pages, start=1):
        rows = {snr_db: [images.get((*variant, snr_db), NOT_RUN) for variant in page] for snr_db in snrs_db}
        columns = [looks[variant].label for variant in page]
        suffix = f"-{number}" if len(pages) > 1 else ""
        heading = f"{title}, trial {trial}"
        figure = draw_clouds(heading, scene.truth, scene.region, columns, rows, scene.radius_m)
        yield f"{stem}{suffix}", figure


def best_variants(records: pd.DataFrame, candidates: Sequence[Variant]) -> list[Variant]:
    """Choose the estimators whose clouds are drawn: those of least mean deviation, in the order given."""
    if len(candidates) <= MOST_CLOUDS:
        return list(candidates)
    means = records.groupby(["estimator", "params"], sort=False)["deviation"].mean()
    # What failed throughout has no mean, and comes last.
    best = set(means.reindex(list(candidates)).sort_values(kind="stable").index[:MOST_CLOUDS])
    return [variant for variant in candidates if variant in best]


def _images(run: Run, scenario: str, trial: int) -> dict[Hashable, Image]:
    """Images of one trial of a scenario, by name, parameters and SNR."""
    # Numbers first: they are compared much faster than text, and leave little of it.
    places = np.flatnonzero(run.rows["trial"] == trial)
    places = places[run.rows["scenario"].iloc[places] == scenario]
    records = run.rows.iloc[places].set_index(CELL)
    return {
        key: _image(run.cloud_array.cloud(place), record)
        for place, (key, record) in zip(places.tolist(), records.iterrows(), strict=True)
    }


def _image(cloud: PointCloud, record: pd.Series[Any]) -> Image:
    """Cloud of one cell, and what came of it."""
    if record["status"] == "ok":
        hausdorff_m = record[[*PROJECTIONS]].sum()
        return Image(cloud, f"{counted(len(cloud), 'point')}, Hausdorff sum {hausdorff_m:.1f} m")
    return Image(cloud, "nothing detected" if record["status"] == "no_detection" else str(record["status"]))
