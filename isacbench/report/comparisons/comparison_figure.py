"""Figure of a comparison: the curves of both sides, and where they part."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.lines import Line2D

from isacbench.bench.compare.comparison import VERDICTS
from isacbench.bench.studies.intervals import MIN_TRIALS
from isacbench.errors import InputError
from isacbench.files.checked_files import make_own_folder, require_picture
from isacbench.files.escaping import shortened
from isacbench.report.comparisons.words import wording
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
    from isacbench.report.comparisons.words import Wording

FOLDER = "figures"
MAX_PANELS = 12
MAX_COLUMNS = 3
TITLE_WIDTH = 42
TITLE_SIZE = 8.0
LEGEND_WIDTH = 80

BASE = LineLook("base", "0.35", "s", "--", False)
NEW = LineLook("new", "#0072B2", "o", "-", False)
MARKS = {"regression": ("#D55E00", "o"), "improvement": ("#009E73", "D")}


def comparison_paths(comparison: Comparison, folder: Path, plot: Path | None = None) -> dict[str, Path]:
    """Where the figures of a comparison go, by score.

    Parameters
    ----------
    comparison : Comparison
    folder : Path
        Of the new run: by default ``figures/compare-<score>.png`` in it, of two
        estimators ``figures/between-<score>.png``.
    plot : Path, optional
        File to write instead; of several scores all but the first add their
        name to its stem.

    Raises
    ------
    InputError
        If the file has no extension of a picture.
    """
    metrics = list(dict.fromkeys(_drawn(comparison.curves)["metric"]))
    stems = file_stems(metrics)
    if plot is None:
        stem = "compare" if comparison.between is None else "between"
        return {metric: folder / FOLDER / f"{stem}-{stems[metric]}.png" for metric in metrics}
    require_picture(plot)
    return {
        metric: plot if not number else plot.with_stem(f"{plot.stem}-{stems[metric]}")
        for number, metric in enumerate(metrics)
    }


def draw_comparison_files(comparison: Comparison, folder: Path, plot: Path | None = None) -> list[Path]:
    """Draw every score of a comparison into the files that `comparison_paths` names.

    Returns
    -------
    list of Path
        What was written; nothing where nothing was compared.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    found = []
    for metric, path in comparison_paths(comparison, folder, plot).items():
        if plot is None:
            make_own_folder(path.parent)
        else:
            _make_folder(path)
        with styled():
            found.append(save(draw_changes(comparison, metric), path))
    return found


def _make_folder(path: Path) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error


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
    points = _drawn(comparison.points[comparison.points["metric"] == metric])
    curves = _drawn(comparison.curves[comparison.curves["metric"] == metric])
    shown = _worst_first(curves, points) if len(curves) > MAX_PANELS else curves
    said = wording(comparison)
    verdicts = points["verdict"].unique()
    figure, panels = panel_grid(
        len(shown), _legend(said, verdicts), _title(metric, shown, curves), MAX_COLUMNS
    )
    for axes, curve in zip(panels, shown.to_dict("records"), strict=True):
        chosen = (
            points[["scenario", "estimator", "params"]]
            == [curve["scenario"], curve["estimator"], curve["params"]]
        ).all(axis=1)
        _draw_panel(axes, points[chosen].sort_values("snr_db"))
        name = _name(curve["scenario"], said.estimators(curve))
        colour, _ = MARKS.get(str(curve["verdict"]), ("black", ""))
        axes.set_title(
            f"{name}\nwhole curve: {_outcome(curve, said)}", color=colour, fontsize=TITLE_SIZE, pad=4.0
        )
    return figure


def _drawn(table: pd.DataFrame) -> pd.DataFrame:
    """Curves or points that have anything to draw: a pair at least."""
    return table[table["n_pairs"] > 0]


def _worst_first(curves: pd.DataFrame, points: pd.DataFrame) -> pd.DataFrame:
    """The curves that a reader wants to see, worst verdict of the curve or any of its points first."""
    rank = {verdict: index for index, verdict in enumerate(VERDICTS)}
    keys = ["scenario", "estimator", "params"]
    worst_point = points.assign(rank=points["verdict"].map(rank)).groupby(keys, sort=False)["rank"].min()
    of_curve = curves["verdict"].map(rank).to_numpy()
    of_points = worst_point.loc[list(map(tuple, curves[keys].to_numpy()))].to_numpy()
    order = np.argsort(np.minimum(of_curve, of_points), kind="stable")
    return curves.iloc[order[:MAX_PANELS]]


def _title(metric: str, shown: pd.DataFrame, curves: pd.DataFrame) -> str:
    n_trials = int(curves["n_pairs"].max())
    part = f", {len(shown)} of {len(curves)} curves" if len(shown) < len(curves) else ""
    return f"{drawable(metric)} of paired cells: {mean_of_trials(n_trials)}{part}"


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
    return Line2D(
        x,
        y,
        linestyle="",
        marker=marker,
        markersize=10,
        markerfacecolor="none",
        markeredgewidth=1.6,
        markeredgecolor=colour,
        label=label,
    )


def _draw_panel(axes: Axes, points: pd.DataFrame) -> None:
    """Draw both curves with their bands, and rings around points that changed."""
    axes.set_xlabel("SNR [dB]")
    if len(points) <= MAX_SNR_TICKS:
        axes.set_xticks(points["snr_db"])
    axes.set_ylabel(drawable(axis_name(points["metric"].iloc[0])))
    axes.grid(True)
    for look, run in ((BASE, "base"), (NEW, "new")):
        mean, band = points[f"{run}_mean"], _band(points, run)
        draw_line(axes, look, points["snr_db"], mean, mean - band, mean + band)
    for verdict in MARKS:
        marked = points[points["verdict"] == verdict]
        if len(marked):
            axes.add_line(_mark(verdict, marked["snr_db"], marked["new_mean"]))
    axes.set_ylim(*_limits(points))


def _band(points: pd.DataFrame, run: str) -> pd.Series[float]:
    """Half widths of the confidence bands of a run; NaN of fewer than five trials."""
    return points[f"{run}_band"].where(points["n_pairs"] >= MIN_TRIALS)


def _limits(points: pd.DataFrame) -> tuple[float, float]:
    """Ends of the axis: all means, and bands as long as they do not dwarf them."""
    means = points[["base_mean", "new_mean"]].to_numpy()
    bands = np.transpose([_band(points, run).fillna(0.0) for run in ("base", "new")])
    low, high = float(np.nanmin(means)), float(np.nanmax(means))
    # Curves that hardly vary are not blown up to fill the panel.
    reach = max(high - low, 0.2 * max(abs(low), abs(high))) or 1.0
    low, high = max(np.nanmin(means - bands), low - reach), min(np.nanmax(means + bands), high + reach)
    missing = max(reach - (high - low), 0.0) / 2
    return low - missing - 0.08 * reach, high + missing + 0.08 * reach


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
