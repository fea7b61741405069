"""Figures of a population: ratios of every scene, scores over SNR by family, and the worst images."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter

from isacbench.bench.cells.record import CLOUD_KEYS
from isacbench.bench.plan.labels import rows_of
from isacbench.bench.store.run import CellKey, Run
from isacbench.bench.studies.population_study import (
    ALL,
    PHASES,
    VARIANT,
    scene_cells,
    summarise_population,
)
from isacbench.files.escaping import counted
from isacbench.model.cloud import PointCloud
from isacbench.report.drawing.panels import MAX_SNR_TICKS, draw_line, legend_lines, panel_grid
from isacbench.report.drawing.style import drawable, file_stems, looks_over, new_figure
from isacbench.report.figures.cloud_figures import Image, draw_comparison
from isacbench.report.figures.curves import nearest_values, variant_looks, write_plain_numbers
from isacbench.report.figures.run_figures import radii, tradeoffs

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from isacbench.bench.plan.labels import Variant
    from isacbench.report.drawing.style import LineLook
    from isacbench.report.figures.curves import NamedFigure

MOST_WORST = 6
"""Most estimators whose worst scene is drawn."""

WORST_SNR_DB = 10.0
"""SNR of the pictures of worst scenes, if it was run, otherwise the nearest one."""

LARGEST_RATIO = 100.0
"""Larger ratios are drawn at the edge."""

SMALLEST_NMSE = 1e-8
"""Smaller values are drawn at the edge."""

COLUMN_IN, ROW_IN = 2.1, 0.28
SPREAD = 0.3
"""Share of a row's height over which the dots of scenes are spread, up and down."""

MARKERS = dict(zip(PHASES.values(), "oD", strict=True))
FILLED = "panel"
"""Frame whose dots are filled; those of the other one are open."""


class _Curve(NamedTuple):
    """Score over SNR: the name of its axis, its column, the stem of its interval, and the kind of axis."""

    axis: str
    column: str
    stem: str
    scale: Literal["share", "positive", "log"] = "share"


RATIO = _Curve("ratio to the oracle", "ratio_median", "ratio", "log")
CURVES = (
    RATIO,
    _Curve("F-score", "f_score_mean", "f_score"),
    _Curve("objects detected", "objects_detected_mean", "objects_detected"),
    _Curve("velocity error [m/s]", "velocity_error_mps_mean", "velocity_error_mps", "positive"),
    _Curve("precision", "precision_mean", "precision"),
    _Curve("recall", "recall_mean", "recall"),
)
TARGETS = (
    _Curve("false points an image", "n_false_mean", "n_false", "positive"),
    _Curve("images without false points", "share_clean_mean", "share_clean"),
    _Curve("scatterers resolved", "share_resolved_mean", "share_resolved"),
    _Curve("images with all met", "share_met_mean", "share_met"),
)


def population_figures(run: Run) -> Iterator[NamedFigure]:
    """Draw ratios of all scenes, scores over SNR by family, and each estimator's worst scene.

    Parameters
    ----------
    run : Run

    Yields
    ------
    stem : str
        Of the file.
    figure : Figure
    """
    # Bands are over scenes here, and not over the realisations of a reference.
    looks = {
        variant: replace(look, label=look.label.replace(" ± spread", ""))
        for variant, look in variant_looks(run.rows).items()
    }
    cells, summary = scene_cells(run.rows), summarise_population(run.rows)
    if cells["ratio"].notna().any():
        yield "ratios", draw_ratios(cells, looks)
    yield "scores", draw_score_curves(summary, looks)
    yield from radii(run, looks)
    lone = summary.loc[summary["n_false_mean"].notna(), "family"].unique()
    for family, stem in file_stems(lone).items():
        yield f"targets-{stem}", draw_targets(summary, family, looks)
    yield from tradeoffs(run, looks)
    yield from _worst_images(run, cells, looks)


def draw_ratios(cells: pd.DataFrame, looks: Mapping[Variant, LineLook]) -> Figure:
    """Draw the ratio of every scene to the oracle, a panel for each family and SNR.

    Parameters
    ----------
    cells : DataFrame
        As `isacbench.bench.studies.population_study.scene_cells` returns them.
    looks : mapping of (str, str) to LineLook
        An estimator has a row; one that sees the truth is a line at its median.

    Returns
    -------
    Figure
    """
    keys = ["family", "snr_db", *VARIANT, "scenario", "frame", "phases"]
    scenes = cells.dropna(subset="ratio").groupby(keys, sort=False)["ratio"].mean().reset_index()
    scenes["ratio"] = scenes["ratio"].clip(upper=LARGEST_RATIO)
    families, snrs_db = scenes["family"].unique(), sorted(scenes["snr_db"].unique())
    rows = {variant: look for variant, look in looks.items() if not look.is_bound} or dict(looks)
    references = {variant: look for variant, look in looks.items() if variant not in rows}
    figure = new_figure(
        max(7.0, 1.2 + COLUMN_IN * len(families)),
        0.9 + len(snrs_db) * (0.75 + ROW_IN * len(rows)),
        legend=[*legend_lines(references.values()), *_marker_lines(scenes)],
        title="Hausdorff sum of each scene, divided by that of the oracle (0.3 m or more)\n"
        "a dot a scene, a bar from quartile to quartile, a line at the median",
    )
    panels = figure.subplots(len(snrs_db), len(families), squeeze=False, sharex=True, sharey=True)
    for (row, snr_db), (column, family) in product(enumerate(snrs_db), enumerate(families)):
        axes = panels[row, column]
        part = scenes[(scenes["snr_db"] == snr_db) & (scenes["family"] == family)]
        for place, (variant, look) in enumerate(rows.items()):
            _draw_strip(axes, place, rows_of(part, variant), look)
        for variant, look in references.items():
            axes.axvline(rows_of(part, variant)["ratio"].median(), color=look.colour, linestyle=look.line)
        axes.set_title(f"{drawable(family)}, {snr_db:g} dB")
        axes.grid(True, axis="x")
    for axes in panels[-1]:
        axes.set_xlabel(RATIO.axis)
    first = panels[0, 0]
    first.set(xscale="log", ylim=(len(rows) - 0.4, -0.6), yticks=range(len(rows)))
    first.set_yticklabels([look.label for look in rows.values()])
    first.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    write_plain_numbers(first.xaxis)
    return figure


def draw_score_curves(summary: pd.DataFrame, looks: Mapping[Variant, LineLook]) -> Figure:
    """Draw scores over SNR, a row of panels for each score, a column for each family.

    Parameters
    ----------
    summary : DataFrame
        As `isacbench.bench.studies.population_study.summarise_population` returns it.
    looks : mapping of (str, str) to LineLook

    Returns
    -------
    Figure
    """
    whole = _by_snr(summary)
    looks = looks_over(whole["snr_db"], looks)
    families = list(whole["family"].unique())
    curves = [curve for curve in CURVES if curve.column in summary]  # older rows lack some
    figure = new_figure(
        max(7.0, 0.6 + COLUMN_IN * len(families)),
        0.8 + 1.85 * len(curves),
        legend=legend_lines(looks.values()),
        title=f"Means, and medians of the ratio, over scenes{_bands(whole)}",
    )
    panels = figure.subplots(len(curves), len(families), squeeze=False, sharex=True, sharey="row")
    for (row, curve), (column, family) in product(enumerate(curves), enumerate(families)):
        axes, part = panels[row, column], whole[whole["family"] == family]
        _draw_curves(axes, curve, part, looks)
        if row == 0:
            axes.set_title("all scenes" if family == ALL else drawable(family))
        if column == 0:
            axes.set_ylabel(curve.axis)
    seeing = {name for (name, _), look in looks.items() if look.is_bound}
    for axes, curve in zip(panels[:, 0], curves, strict=True):
        _scale(axes, curve, whole.loc[~whole["estimator"].isin(seeing), curve.column].max())
    for axes in panels[-1]:
        axes.set_xlabel(_snr_axis(whole))
    return figure


def draw_targets(summary: pd.DataFrame, family: str, looks: Mapping[Variant, LineLook]) -> Figure:
    """Draw how far the absolute targets of a family of lone scatterers are met, over SNR.

    Parameters
    ----------
    summary : DataFrame
        As `isacbench.bench.studies.population_study.summarise_population` returns it.
    family : str
    looks : mapping of (str, str) to LineLook

    Returns
    -------
    Figure
    """
    whole = _by_snr(summary)
    part = whole[whole["family"] == family]
    looks = looks_over(part["snr_db"], looks)
    title = f"{drawable(family)}: means over {counted(int(part['n_scenes'].max()), 'scene')}{_bands(part)}"
    figure, panels = panel_grid(len(TARGETS), legend_lines(looks.values()), title)
    for axes, curve in zip(panels, TARGETS, strict=True):
        _draw_curves(axes, curve, part, looks)
        _scale(axes, curve)
        axes.set(xlabel=_snr_axis(part), ylabel=curve.axis)
    return figure


def _by_snr(summary: pd.DataFrame) -> pd.DataFrame:
    """Rows over all frames and phases, at each SNR."""
    return summary[(summary["frame"] == ALL) & (summary["phases"] == ALL)].dropna(subset="snr_db")


def _bands(part: pd.DataFrame) -> str:
    """Say that there are bands, if there are."""
    return ", 95 % confidence bands" if part["recall_band"].notna().any() else ""


def _snr_axis(part: pd.DataFrame) -> str:
    """Name of the axis below; of a single SNR the SNR itself, at which estimators stand side by side."""
    snrs_db = part["snr_db"].unique()
    return "SNR [dB]" if len(snrs_db) > 1 else f"SNR {snrs_db[0]:g} dB"


def _draw_strip(axes: Axes, place: int, part: pd.DataFrame, look: LineLook) -> None:
    """Draw the dots of an estimator's scenes in its row, over a bar of their quartiles."""
    if part.empty:
        return
    quartiles = part["ratio"].quantile([0.25, 0.5, 0.75]).to_numpy()
    axes.plot(
        quartiles[[0, 2]], [place, place], color=look.colour, alpha=0.3, linewidth=7, solid_capstyle="butt"
    )
    axes.plot(quartiles[[1, 1]], [place - SPREAD, place + SPREAD], color="0.15", linewidth=1.6)
    # Neighbours in ratio at different heights, the same in every run.
    heights = place + SPREAD * (np.arange(len(part)) * 0.618 % 1 * 2 - 1)
    ordered = part.sort_values("ratio", kind="stable").assign(height=heights)
    for (frame, phases), dots in ordered.groupby(["frame", "phases"]):
        axes.scatter(dots["ratio"], dots["height"], **_dot(str(frame), str(phases), look.colour))


def _dot(frame: str, phases: str, colour: str) -> dict[str, Any]:
    """Look of a scene's dot."""
    face = colour if frame == FILLED else "white"
    return {"marker": MARKERS[phases], "s": 9, "facecolor": face, "edgecolor": colour, "linewidth": 0.7}


def _marker_lines(scenes: pd.DataFrame) -> list[Line2D]:
    """Legend entries of the frames and phases that occur."""
    return [
        Line2D(
            [],
            [],
            linestyle="",
            marker=MARKERS[phases],
            markersize=4,
            color="0.3",
            markerfacecolor="0.3" if frame == FILLED else "white",
            label=f"frame {frame}, {phases} phases".replace("in phase phases", "in phase"),
        )
        for frame, phases in sorted(set(zip(scenes["frame"], scenes["phases"], strict=True)))
    ]


def _draw_curves(axes: Axes, curve: _Curve, part: pd.DataFrame, looks: Mapping[Variant, LineLook]) -> None:
    """Draw one score of one family for every estimator; nothing but the title where none has it."""
    if part[curve.column].isna().all():
        axes.set_axis_off()
        return
    snrs_db = sorted(part["snr_db"].unique())
    for place, (variant, look) in enumerate(looks.items()):
        rows = rows_of(part, variant).sort_values("snr_db")
        middle, low, high = _with_ends(rows, curve)
        # At a single SNR, estimators stand side by side.
        x = rows["snr_db"] if len(snrs_db) > 1 else [place] * len(rows)
        draw_line(axes, look, x, middle, low, high, alpha=0.1)
    if len(snrs_db) == 1:
        axes.set_xticks([])
    elif len(snrs_db) <= MAX_SNR_TICKS:
        axes.set_xticks(snrs_db)
    axes.grid(True)


def _with_ends(rows: pd.DataFrame, curve: _Curve) -> list[pd.Series[float]]:
    """Score and both ends of its interval, as they are drawn."""
    middle = rows[curve.column]
    if f"{curve.stem}_band" in rows:
        band = rows[f"{curve.stem}_band"]
        found = [middle, middle - band, middle + band]
    else:
        found = [middle, rows[f"{curve.stem}_low"], rows[f"{curve.stem}_high"]]
    return [values.clip(lower=SMALLEST_NMSE) if curve.scale == "log" else values for values in found]


def _scale(axes: Axes, curve: _Curve, most: float = math.nan) -> None:
    """Scale an axis by the sort of its score, and up to the largest of those that do not see the truth."""
    if curve.scale == "log":
        axes.set_yscale("log")
        axes.yaxis.set_minor_formatter(NullFormatter())
        if curve is RATIO:
            axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            write_plain_numbers(axes.yaxis)
    elif curve.scale == "share":
        axes.set_ylim(-0.03, 1.03)
    else:
        top = 1.1 * most if most > 0 else axes.get_ylim()[1]
        axes.set_ylim(-0.03 * top, top)


def _worst_images(run: Run, cells: pd.DataFrame, looks: Mapping[Variant, LineLook]) -> Iterator[NamedFigure]:
    """Draw the scene in which each estimator has its largest ratio, beside the truth."""
    (snr_db,) = nearest_values(sorted(cells["snr_db"].unique()), [WORST_SNR_DB])
    rated = cells[cells["snr_db"] == snr_db].dropna(subset="ratio")
    chosen = [variant for variant, look in looks.items() if not look.is_bound][:MOST_WORST]
    stems = file_stems(looks[variant].label for variant in chosen)
    for variant, stem in zip(chosen, stems.values(), strict=True):
        scenes = rows_of(rated, variant)
        if scenes.empty:
            continue
        worst = scenes.iloc[scenes["ratio"].argmax()]
        cloud = run.clouds.get(CellKey(*worst[CLOUD_KEYS]), PointCloud.empty())
        scene = run.scenarios[worst["scenario"]]
        title = f"{drawable(scene.name)} at {snr_db:g} dB: the worst ratio of {counted(len(scenes), 'scene')}"
        note = f"{counted(len(cloud), 'point')}, {worst['ratio']:.1f} times the Hausdorff sum of the oracle"
        image = Image(cloud, note)
        figure = draw_comparison(
            title, scene.truth, looks[variant].label, image, scene.region, scene.radius_m
        )
        yield f"worst-{stem}", figure
