"""Figure of a comparison: the curves of both sides, and where they part."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.lines import Line2D

from isacbench.bench.compare.matching import CURVE
from isacbench.bench.compare.verdicts import VERDICTS
from isacbench.files.checked_files import make_own_folder, require_picture
from isacbench.files.escaping import shortened
from isacbench.report.comparisons.words import Wording
from isacbench.report.drawing.panels import MAX_SNR_TICKS, draw_line, legend_lines, panel_grid
from isacbench.report.drawing.style import LineLook, drawable, file_stems, save, styled
from isacbench.report.figures.curves import axis_name
from isacbench.report.tables.run_tables import mean_of_trials

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping, Sequence
    from pathlib import Path

    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from isacbench.bench.compare.comparison import Comparison

FOLDER = "figures"
MAX_PANELS = 12
MAX_COLUMNS = 3
TITLE_WIDTH = 42
TITLE_SIZE = 8.0
LEGEND_WIDTH = 80

BASE = LineLook("base", "0.35", "s", "--", False)
NEW = LineLook("new", "#0072B2", "o", "-", False)
RING: dict[str, Any] = {"linestyle": "", "markersize": 10, "markerfacecolor": "none", "markeredgewidth": 1.6}
MARKS = {"regression": ("#D55E00", "o"), "improvement": ("#009E73", "D")}


def comparison_paths(comparison: Comparison, folder: Path, plot: Path | None = None) -> dict[str, Path]:
    """Name the files for the figures of a comparison, by score.

    Parameters
    ----------
    comparison : Comparison
    folder : Path
        Of the new run: by default ``figures/compare-<score>.png`` in it, of two
        estimators ``figures/between-<score>.png``.
    plot : Path, optional
        File to write instead; of several scores all but the first add their
        name to its stem.

    Returns
    -------
    dict of str to Path

    Raises
    ------
    InputError
        If the file has no extension of a picture.
    """
    metrics = comparison.curves.loc[comparison.curves["n_pairs"] > 0, "metric"].unique().tolist()
    stems = file_stems(metrics)
    if plot is None:
        stem = "compare" if comparison.between is None else "between"
        return {metric: folder / FOLDER / f"{stem}-{stems[metric]}.png" for metric in metrics}
    require_picture(plot)
    others = {metric: plot.with_stem(f"{plot.stem}-{stems[metric]}") for metric in metrics[1:]}
    return {**dict.fromkeys(metrics[:1], plot), **others}


def draw_comparison_files(comparison: Comparison, folder: Path, plot: Path | None = None) -> list[Path]:
    """Draw every score of a comparison into the files that `comparison_paths` names.

    Parameters
    ----------
    comparison : Comparison
    folder : Path
    plot : Path, optional
        As `comparison_paths` takes them.

    Returns
    -------
    list of Path
        Written files; none where nothing was compared.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    found = []
    for metric, path in comparison_paths(comparison, folder, plot).items():
        # A folder that the user has named may be a link, that of a run may not.
        make_own_folder(path.parent if plot is None else path.parent.resolve())
        with styled():
            found.append(save(draw_changes(comparison, metric), path))
    return found


def draw_changes(comparison: Comparison, metric: str) -> Figure:
    """Draw one score of both sides over the SNR, a panel a curve, points that changed marked.

    Parameters
    ----------
    comparison : Comparison
    metric : str
        One that it compares, with a pair at least.

    Returns
    -------
    Figure
        The twelve curves with the worst verdicts, where there are more.
    """
    points, curves = (
        table[(table["metric"] == metric) & (table["n_pairs"] > 0)]
        for table in (comparison.points, comparison.curves)
    )
    shown = _worst_first(curves, points) if len(curves) > MAX_PANELS else curves
    said = Wording(comparison)
    part = f", {len(shown)} of {len(curves)} curves" if len(shown) < len(curves) else ""
    n_pairs = int(curves["n_pairs"].max())
    mean = (
        mean_of_trials(n_pairs) if said.unit == "trial" else f"mean of {n_pairs} scenes, 95 % confidence band"
    )
    title = f"{drawable(metric)} of paired cells: {mean}{part}"
    figure, panels = panel_grid(len(shown), _legend(said, points["verdict"].unique()), title, MAX_COLUMNS)
    of_curve = points.groupby(CURVE)
    for axes, curve in zip(panels, shown.to_dict("records"), strict=True):
        _draw_panel(axes, of_curve.get_group(tuple(curve[key] for key in CURVE)).sort_values("snr_db"))
        name = _name(curve["scenario"], said.estimators(curve))
        colour, _ = MARKS.get(curve["verdict"], ("black", ""))
        axes.set_title(
            f"{name}\nwhole curve: {_outcome(curve, said)}", color=colour, fontsize=TITLE_SIZE, pad=4.0
        )
    return figure


def _worst_first(curves: pd.DataFrame, points: pd.DataFrame) -> pd.DataFrame:
    """The curves that a reader wants to see, worst verdict of the curve or any of its points first."""
    rank = points["verdict"].map(VERDICTS.index)
    worst_point = points.assign(rank=rank).groupby(CURVE)["rank"].min().rename("worst_point")
    ranks = curves.join(worst_point, on=CURVE)["worst_point"]
    order = np.minimum(ranks, curves["verdict"].map(VERDICTS.index)).argsort(kind="stable")
    return curves.iloc[order[:MAX_PANELS]]


def _legend(said: Wording, verdicts: Any) -> list[Line2D]:
    """Entries of both sides and of the marks that occur."""
    looks = [
        replace(look, label=drawable(shortened(text, LEGEND_WIDTH)))
        for look, text in zip((BASE, NEW), said.legend, strict=True)
    ]
    marks = [_mark(verdict, [], [], label=said.verdict(verdict)) for verdict in MARKS if verdict in verdicts]
    return [*legend_lines(looks), *marks]


def _mark(verdict: str, x: Any, y: Any, label: str = "") -> Line2D:
    """Ring around points of a verdict."""
    colour, marker = MARKS[verdict]
    return Line2D(x, y, marker=marker, markeredgecolor=colour, label=label, **RING)


def _draw_panel(axes: Axes, points: pd.DataFrame) -> None:
    """Draw both curves with their bands, and rings around points that changed."""
    axes.set_xlabel("SNR [dB]")
    if len(points) <= MAX_SNR_TICKS:
        axes.set_xticks(points["snr_db"])
    axes.set_ylabel(drawable(axis_name(points["metric"].iloc[0])))
    axes.grid(True)
    for look, run in ((BASE, "base"), (NEW, "new")):
        mean, band = points[f"{run}_mean"], points[f"{run}_band"]
        draw_line(axes, look, points["snr_db"], mean, mean - band, mean + band)
    for verdict in MARKS:
        marked = points[points["verdict"] == verdict]
        if len(marked):
            axes.add_line(_mark(verdict, marked["snr_db"], marked["new_mean"]))
    # Bands do not dwarf the means, and curves that hardly vary are not blown up to fill the panel.
    means = points[["base_mean", "new_mean"]].to_numpy()
    low, high = float(means.min()), float(means.max())
    margin = max(0.3 * (high - low), 0.1 * max(abs(low), abs(high))) or 1.0
    axes.set_ylim(low - margin, high + margin)


def _name(scenario: str, estimators: Sequence[str]) -> str:
    """Name a curve above its panel, on two lines at most."""
    one_line = ", ".join([scenario, *estimators])
    lines = [scenario, *estimators]
    if len(estimators) == 2:
        lines = [f"{scenario}, {estimators[0]}", f"→ {estimators[1]}"]
    elif len(one_line) <= TITLE_WIDTH:
        lines = [one_line]
    return "\n".join(drawable(shortened(line, TITLE_WIDTH)) for line in lines)


def _outcome(curve: Mapping[Hashable, Any], said: Wording) -> str:
    """Say what became of a whole curve."""
    relative = curve["relative"]
    change = f" ({100 * relative:+.3g} %)" if relative and np.isfinite(relative) else ""
    return f"{said.verdict(curve['verdict'])}{change}"
