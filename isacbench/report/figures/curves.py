"""Figures of scores over SNR, one line for each estimator."""

from __future__ import annotations

import textwrap
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.ticker import FuncFormatter, NullFormatter

from isacbench.bench.plan.labels import estimator_labels, find_limits, rows_of, variants_in
from isacbench.metrics.one_to_one import Curve
from isacbench.metrics.paper import Paper
from isacbench.report.drawing.panels import MAX_SNR_TICKS, draw_line, legend_lines, panel_grid
from isacbench.report.drawing.style import assign_looks, drawable, looks_over
from isacbench.report.tables.run_tables import mean_of_trials

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    from isacbench.bench.plan.labels import Variant
    from isacbench.report.drawing.style import LineLook

    NamedFigure = tuple[str, Figure]

TITLE_WIDTH = 40
PRACTICALLY_ZERO = 1e-6
"""Smaller means do not stretch a logarithmic axis: such velocities are exact for any purpose."""

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

LARGEST_BAND = 1.5
"""Largest upper end of a linear axis that shows bands, as a multiple of the largest mean."""


class _Panel(NamedTuple):
    """One score: its column, its title, the name and unit of its axis, and whether that is logarithmic."""

    column: str
    title: str
    axis: str
    logarithmic: bool = False


def _described(column: str, axis: str, logarithmic: bool = False) -> _Panel:
    """Panel of a score, titled as the metric describes it."""
    description = next(one.description for one in Paper.columns if one.name == column)
    return _Panel(column, description[0].upper() + description[1:], axis, logarithmic)


DEVIATION = _described("deviation", "imaging deviation")
PANELS = (
    DEVIATION,
    _Panel("hausdorff_sum_m", "Sum of the three Hausdorff distances", "Hausdorff sum [m]"),
    _described("density", "density error"),
    _described("velocity_nmse", "velocity NMSE", logarithmic=True),
    _described("hausdorff_xy_m", "Hausdorff distance xy [m]"),
    _described("hausdorff_xz_m", "Hausdorff distance xz [m]"),
    _described("hausdorff_yz_m", "Hausdorff distance yz [m]"),
    _described("chamfer_m", "chamfer distance [m]"),
    _Panel("gospa_m", "GOSPA distance: misplaced, missed and false points", "GOSPA distance [m]"),
    _Panel("gospa_skill", "GOSPA's skill: 0 of an empty image, 1 of the truth", "GOSPA skill"),
    _Panel("velocity_error_mps", "Velocity error of matched points", "velocity error [m/s]"),
    _Panel("f_score", "F-score of points matched one to one within {radius_m:g} m", "F-score"),
    _Panel("objects_detected", "Share of objects that were detected", "objects detected"),
    _Panel("n_objects_false", "Found objects that are none", "false objects an image"),
    _Panel("precision", "Share of estimated points within {radius_m:g} m of a true scatterer", "precision"),
    _Panel("recall", "Share of true scatterers within {radius_m:g} m of an estimated point", "recall"),
)
SHARES = "f_score", "objects_detected", "precision", "recall"


def variant_looks(records: pd.DataFrame) -> dict[Variant, LineLook]:
    """Give every estimator of a run its own colour, line and marker, the same in all figures.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.

    Returns
    -------
    dict of (str, str) to LineLook
        By name and parameters.
    """
    return assign_looks(estimator_labels(variants_in(records)), find_limits(records))


def nearest_values(available: Sequence[float], wanted: Sequence[float]) -> list[float]:
    """Select the values nearest to wanted ones.

    Parameters
    ----------
    available, wanted : sequence of float

    Returns
    -------
    list of float
        In the order of the wanted ones, each once.
    """
    return list(dict.fromkeys(min(available, key=lambda value: abs(value - target)) for target in wanted))


def share_scale(panels: Sequence[Axes], axis: str) -> None:
    """Put panels on one scale.

    Parameters
    ----------
    panels : sequence of Axes
    axis : {"x", "y"}
    """
    lower, upper = np.transpose([axes.get_xlim() if axis == "x" else axes.get_ylim() for axes in panels])
    for axes in panels:
        axes.set(**{f"{axis}lim": (lower.min(), upper.max())})


def write_plain_numbers(axis: Axis) -> None:
    """Write the ticks of a logarithmic axis as plain numbers.

    Parameters
    ----------
    axis : Axis
    """
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def axis_name(column: str) -> str:
    """Name of the axis of a column: for a score its name with its unit, otherwise the column itself.

    Parameters
    ----------
    column : str

    Returns
    -------
    str

    Examples
    --------
    >>> axis_name("gospa_m"), axis_name("time_estimate_s")
    ('GOSPA distance [m]', 'time_estimate_s')
    """
    return next((panel.axis for panel in PANELS if panel.column == column), column)


def draw_scores(
    summary: pd.DataFrame,
    scenario: str,
    looks: Mapping[Variant, LineLook],
    radius_m: float,
    gain_db: float | None = None,
) -> Figure:
    """Draw the deviation of one scenario, its components, and the other scores.

    Parameters
    ----------
    summary : DataFrame
        As `isacbench.bench.studies.imaging_study.summarise_scores` returns it.
    scenario : str
        Its name.
    looks : mapping of (str, str) to LineLook
    radius_m : float
        Radius of precision and recall in m.
    gain_db : float, optional
        From the SNR to that of a median scatterer after all gains.

    Returns
    -------
    Figure
    """
    panels = [panel for panel in PANELS if f"{panel.column}_mean" in summary]
    return _draw_panels(summary, scenario, panels, looks, radius_m, gain_db)


def draw_score(
    summary: pd.DataFrame,
    scenario: str,
    column: str,
    looks: Mapping[Variant, LineLook],
    radius_m: float,
    gain_db: float | None = None,
) -> Figure:
    """Draw one score of one scenario.

    Parameters
    ----------
    summary : DataFrame
        As `isacbench.bench.studies.imaging_study.summarise_scores` returns it.
    scenario, column : str
        Names of the scenario and of the score.
    looks : mapping of (str, str) to LineLook
    radius_m : float
        Radius of precision and recall in m.
    gain_db : float, optional
        From the SNR to that of a median scatterer after all gains.

    Returns
    -------
    Figure
    """
    panels = [panel for panel in PANELS if panel.column == column] or [_Panel(column, column, column)]
    return _draw_panels(summary, scenario, panels, looks, radius_m, gain_db)


def _draw_panels(
    summary: pd.DataFrame,
    scenario: str,
    chosen: Sequence[_Panel],
    looks: Mapping[Variant, LineLook],
    radius_m: float,
    gain_db: float | None,
) -> Figure:
    """Draw some scores of one scenario."""
    part = summary[summary["scenario"] == scenario]
    looks = looks_over(part["snr_db"], looks)
    title = f"{drawable(scenario)}: {mean_of_trials(int(part['n_cells'].max()))}"
    if gain_db is not None:
        title += f"\na median scatterer after all gains: SNR {gain_db:+.1f} dB"
    figure, panels = panel_grid(len(chosen), _legend(looks, part), title)
    for axes, panel in zip(panels, chosen, strict=True):
        _draw_panel(axes, panel, looks, part)
        axes.set_title(textwrap.fill(panel.title.format(radius_m=radius_m), TITLE_WIDTH))
    return figure


def draw_deviations(
    summary: pd.DataFrame, looks: Mapping[Variant, LineLook], subtitle: str | None = None
) -> Figure:
    """Draw the deviation of every scenario, side by side on one scale.

    Parameters
    ----------
    summary : DataFrame
        As `isacbench.bench.studies.imaging_study.summarise_scores` returns it.
    looks : mapping of (str, str) to LineLook
    subtitle : str, optional
        Says what means are taken over; by default over trials.

    Returns
    -------
    Figure
    """
    scenarios = list(summary["scenario"].unique())
    looks = looks_over(summary["snr_db"], looks)
    title = f"{DEVIATION.title}\n{subtitle or mean_of_trials(int(summary['n_cells'].max()))}"
    figure, panels = panel_grid(len(scenarios), _legend(looks, summary), title)
    for axes, scenario in zip(panels, scenarios, strict=True):
        _draw_panel(axes, DEVIATION, looks, summary[summary["scenario"] == scenario])
        axes.set_title(drawable(scenario))
    share_scale(panels, "y")
    return figure


def draw_radii(
    curves: Mapping[Variant, Sequence[Curve]], looks: Mapping[Variant, LineLook], title: str
) -> Figure:
    """Draw F-score, precision and recall of points matched one to one over the radius, means over images.

    Parameters
    ----------
    curves : mapping of (str, str) to sequence of Curve
        One an image.
    looks : mapping of (str, str) to LineLook
        Looks of the estimators, as `variant_looks` gives them.
    title : str

    Returns
    -------
    Figure
        The legend has the area under each F-score.
    """
    means = {variant: np.nanmean(own, axis=0) for variant, own in curves.items() if own}
    drawn = {
        variant: replace(looks[variant], label=f"{looks[variant].label}: area {Curve(*mean).area:.2f}")
        for variant, mean in means.items()
    }
    figure, panels = panel_grid(3, legend_lines(drawn.values()), title)
    for axes, name in zip(panels, ("f_score", "precision", "recall"), strict=True):
        for variant, look in drawn.items():
            mean = Curve(*means[variant])
            axes.plot(mean.radius_m, getattr(mean, name), color=look.colour, linestyle=look.line)
        axes.set(xscale="log", xlabel="radius [m]", ylabel=name.replace("f_score", "F-score"), ylim=(0, 1.02))
        axes.set_xticks([0.1, 0.3, 1.0, 3.0])
        write_plain_numbers(axes.xaxis)
        axes.grid(True)
    return figure


def _legend(looks: Mapping[Variant, LineLook], summary: pd.DataFrame) -> list[Line2D]:
    """Legend entries of the estimators, marked where an estimator has no curve."""
    entries = legend_lines(looks.values())
    for entry, (variant, look) in zip(entries, looks.items(), strict=True):
        if rows_of(summary, variant)["deviation_mean"].isna().all():
            entry.set_label(f"{look.label}: no score")
    return entries


def _draw_panel(axes: Axes, panel: _Panel, looks: Mapping[Variant, LineLook], part: pd.DataFrame) -> None:
    """Draw one score of one scenario for every estimator that has it."""
    means, halves = part[f"{panel.column}_mean"], part[f"{panel.column}_band"]
    snrs_db = np.unique(part["snr_db"])
    axes.set(xlabel="SNR [dB]", ylabel=panel.axis)
    if snrs_db.size <= MAX_SNR_TICKS:
        axes.set_xticks(snrs_db)
    axes.grid(True)
    lowest = -np.inf
    if panel.logarithmic:
        lowest = _scale_decades(axes, means)
    else:
        top = 1.03 if panel.column in SHARES else _top(means, halves)
        axes.set_ylim(-0.03 * top, top)
    # The bands of many estimators lie over each other.
    alpha = min(0.22, 0.6 / len(looks))
    drawn = pd.DataFrame({"mean": means, "low": means - halves, "high": means + halves}).clip(lower=lowest)
    drawn = part[["estimator", "params", "snr_db"]].join(drawn).sort_values("snr_db")
    for variant, look in looks.items():
        rows = rows_of(drawn, variant)
        draw_line(axes, look, rows["snr_db"], rows["mean"], rows["low"], rows["high"], alpha)


def _scale_decades(axes: Axes, means: pd.Series[float]) -> float:
    """Scale an axis to whole decades around all means that are not practically zero; return its lower end."""
    shown = means[means > PRACTICALLY_ZERO]
    lowest, highest = PRACTICALLY_ZERO, 1.0
    if len(shown):
        # Half the smallest mean, so that what is drawn at the lower end lies below it.
        lowest, highest = 10 ** np.floor(np.log10(shown.min() / 2)), 10 ** np.ceil(np.log10(shown.max()))
    axes.set(yscale="log", ylim=(0.7 * lowest, 1.5 * highest))
    axes.yaxis.set_major_formatter(FuncFormatter(_power_of_ten))
    axes.yaxis.set_minor_formatter(NullFormatter())
    if (means < lowest).any():
        axes.set_ylabel(f"{axes.get_ylabel()} (less: at the edge)")
    return float(lowest)


def _power_of_ten(value: float, _: int | None = None) -> str:
    """Write a power of ten with Unicode superscripts, faster than Matplotlib's mathematical text.

    Examples
    --------
    >>> _power_of_ten(1e-5), _power_of_ten(1.0)
    ('10⁻⁵', '10⁰')
    """
    return "10" + f"{round(np.log10(value))}".translate(SUPERSCRIPTS)


def _top(means: pd.Series[float], halves: pd.Series[float]) -> float:
    """Upper end of a linear axis: includes all means, and the bands as far as they do not dwarf the means."""
    mean = max(0.0, float(means.fillna(0.0).max()))
    upper = max(mean, float((means + halves).fillna(0.0).max()))
    return 1.06 * min(upper, LARGEST_BAND * mean) or 1.0
