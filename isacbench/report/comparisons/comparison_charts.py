"""Charts of a comparison: the curves of both sides, and where they part."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from isacbench.bench.compare.pairs import CURVE
from isacbench.bench.compare.verdicts import VERDICTS
from isacbench.bench.kinds.imaging import SCORE_AXES
from isacbench.bench.statistics import mean_of_trials
from isacbench.charts import Axis, Chart, ChartGroup, LineStyle, Series
from isacbench.files.checked_files import make_own_folder, require_picture
from isacbench.files.escaping import shortened
from isacbench.files.file_names import file_stems
from isacbench.report.comparisons.words import Wording
from isacbench.report.figures import draw_charts, save, styled

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping, Sequence
    from pathlib import Path

    import pandas as pd

    from isacbench.bench.compare.comparison import Comparison

FOLDER = "figures"
MOST_CHARTS = 12
LONGEST_LINE = 42
BASE, NEW = LineStyle("#595959", "dash", "square"), LineStyle("#0072B2", "solid", "circle")
RINGS = {
    "regression": LineStyle("#D55E00", "", "circle-open"),
    "improvement": LineStyle("#009E73", "", "diamond-open"),
}
"""Marks around points of a verdict."""


def comparison_paths(comparison: Comparison, folder: Path, plot: Path | None = None) -> dict[str, Path]:
    """Name the files for the figures of a comparison, by score.

    By default ``figures/compare-<score>.png`` in the folder of the new run, of two estimators
    ``figures/between-<score>.png``. Instead `plot`, to whose stem all scores but the first add their name.
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
    """Draw every score of a comparison into the files that `comparison_paths` names."""
    found = []
    for metric, path in comparison_paths(comparison, folder, plot).items():
        # A folder that the user has named may be a link, that of a run may not.
        make_own_folder(path.parent if plot is None else path.parent.resolve())
        with styled():
            found.append(save(draw_charts(comparison_charts(comparison, metric)), path))
    return found


def comparison_charts(comparison: Comparison, metric: str) -> ChartGroup:
    """One score of both sides over the SNR, a chart a curve, points that changed marked.

    Of more than twelve curves those with the worst verdicts.
    """
    points, curves = (
        table[(table["metric"] == metric) & (table["n_pairs"] > 0)]
        for table in (comparison.points, comparison.curves)
    )
    shown = _worst_first(curves, points) if len(curves) > MOST_CHARTS else curves
    said = Wording(comparison)
    part = f", {len(shown)} of {len(curves)} curves" if len(shown) < len(curves) else ""
    n_pairs = int(curves["n_pairs"].max())
    mean = (
        mean_of_trials(n_pairs) if said.unit == "trial" else f"mean of {n_pairs} scenes, 95 % confidence band"
    )
    of_curve = points.groupby(CURVE)
    charts = []
    for curve in shown.to_dict("records"):
        own = of_curve.get_group(tuple(curve[key] for key in CURVE)).sort_values("snr_db")
        name = _name(curve["scenario"], said.estimators(curve))
        title = f"{name}\nwhole curve: {_outcome(curve, said)}"
        y = Axis(SCORE_AXES[metric].axis if metric in SCORE_AXES else metric, limits=_limits(own))
        charts.append(Chart(title, Axis("SNR [dB]"), y, _series(own, said)))
    return ChartGroup("compare", f"{metric} of paired cells: {mean}{part}", charts, n_columns=3)


def _worst_first(curves: pd.DataFrame, points: pd.DataFrame) -> pd.DataFrame:
    """The curves that a reader wants to see, worst verdict of the curve or any of its points first."""
    rank = points["verdict"].map(VERDICTS.index)
    worst_point = points.assign(rank=rank).groupby(CURVE)["rank"].min().rename("worst_point")
    ranks = curves.join(worst_point, on=CURVE)["worst_point"]
    order = np.minimum(ranks, curves["verdict"].map(VERDICTS.index)).argsort(kind="stable")
    return curves.iloc[order[:MOST_CHARTS]]


def _series(points: pd.DataFrame, said: Wording) -> list[Series]:
    """Both curves with their bands, and rings around points that changed."""
    found = []
    for style, side, label in zip((BASE, NEW), ("base", "new"), said.legend, strict=True):
        mean, band = points[f"{side}_mean"], points[f"{side}_band"]
        found.append(Series(label, points["snr_db"], mean, mean - band, mean + band, style=style))
    for verdict, style in RINGS.items():
        marked = points[points["verdict"] == verdict]
        if len(marked):
            label = said.verdict(verdict)
            found.append(Series(label, marked["snr_db"], marked["new_mean"], mark="points", style=style))
    return found


def _limits(points: pd.DataFrame) -> tuple[float, float]:
    """Bands do not dwarf the means, and curves that hardly vary are not blown up to fill the chart."""
    means = points[["base_mean", "new_mean"]].to_numpy()
    low, high = float(means.min()), float(means.max())
    margin = max(0.3 * (high - low), 0.1 * max(abs(low), abs(high))) or 1.0
    return low - margin, high + margin


def _name(scenario: str, estimators: Sequence[str]) -> str:
    """Name a curve, on two lines at most."""
    one_line = ", ".join([scenario, *estimators])
    lines = [scenario, *estimators]
    if len(estimators) == 2:
        lines = [f"{scenario}, {estimators[0]}", f"→ {estimators[1]}"]
    elif len(one_line) <= LONGEST_LINE:
        lines = [one_line]
    return "\n".join(shortened(line, LONGEST_LINE) for line in lines)


def _outcome(curve: Mapping[Hashable, object], said: Wording) -> str:
    """Say what became of a whole curve."""
    relative = float(str(curve["relative"]))
    change = f" ({100 * relative:+.3g} %)" if relative and np.isfinite(relative) else ""
    return f"{said.verdict(str(curve['verdict']))}{change}"
