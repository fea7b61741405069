"""Figures of the studies: errors over their bound, probabilities of resolution, detection and false alarm."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.lines import Line2D

from isacbench.bench.plan.labels import rows_of
from isacbench.bench.studies.detection_study import known_noise_rate, summarise_detection
from isacbench.bench.studies.efficiency_study import summarise_efficiency
from isacbench.bench.studies.power_maps import MAPS
from isacbench.bench.studies.resolution_study import summarise_resolution
from isacbench.model.radio_coordinates import DIMENSIONS
from isacbench.report.drawing.panels import draw_line, legend_lines, panel_grid
from isacbench.report.drawing.style import BOUND_COLOUR, assign_looks, drawable, file_stems
from isacbench.report.figures.curves import nearest_values, share_scale, variant_looks, write_plain_numbers
from isacbench.report.tables.run_tables import trials_and_band
from isacbench.report.tables.study_tables import entry_labels, reference_rate

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from isacbench.bench.plan.labels import Variant
    from isacbench.bench.store.run import Run
    from isacbench.report.drawing.style import LineLook
    from isacbench.report.figures.curves import NamedFigure

DIMENSION_TITLES = {
    "range": "Range",
    "velocity": "Velocity",
    "u": "Direction cosine u",
    "w": "Direction cosine w",
}
UNITS = {"range": ("range_m", " [m]"), "velocity": ("velocity_mps", " [m/s]"), "u": ("u", ""), "w": ("w", "")}
"""Ends of the names of columns, and units of axes."""

BAND = ["value", "low", "high"]
MAX_TICKS = 5
ROC_SNRS_DB = 10.0, 15.0, 20.0

LIMIT_LINE: dict[str, Any] = {"color": "0.1", "linestyle": (0, (1, 1)), "linewidth": 1.2}
"""Of what a detector finds that knows the noise."""

LARGEST_RATIO = 10.0
"""Errors so many times the bound are far from it, however far."""

MIN_FALSE_POINTS = 0.1
"""Fewer false points a trial do not stretch their axis."""

LOWEST_RATE_SHARE = 0.1
"""Share of one false alarm of all clear cells at which a count of none is drawn on a logarithmic axis."""


SHARE_LIMITS = -0.03, 1.03
"""Ends of an axis of shares and probabilities."""


def efficiency_figures(run: Run) -> Iterator[NamedFigure]:
    """Draw errors and bounds of every scenario.

    Parameters
    ----------
    run : Run

    Yields
    ------
    stem : str
        Of the file.
    figure : Figure
    """
    summary, looks = summarise_efficiency(run.rows), variant_looks(run.rows)
    for scenario, stem in file_stems(summary["scenario"].unique()).items():
        yield f"efficiency-{stem}", draw_efficiency(summary, scenario, looks)


def resolution_figures(run: Run) -> Iterator[NamedFigure]:
    """Draw probabilities of resolution of every template and SNR.

    Parameters
    ----------
    run : Run

    Yields
    ------
    stem : str
        Of the file.
    figure : Figure
    """
    summary, looks = summarise_resolution(run.rows), variant_looks(run.rows)
    several = summary["snr_gain_db"].nunique() > 1
    for template, stem in file_stems(summary["template"].unique()).items():
        for snr_gain_db, at_snr in summary[summary["template"] == template].groupby("snr_gain_db"):
            suffix = f"-{snr_gain_db:g}dB" if several else ""
            yield f"resolution-{stem}{suffix}", draw_resolution(at_snr, looks)


def detection_figures(run: Run) -> Iterator[NamedFigure]:
    """Draw detectors on the maps, and behind estimators on every scenario.

    Parameters
    ----------
    run : Run

    Yields
    ------
    stem : str
        Of the file.
    figure : Figure
    """
    summary = summarise_detection(run.rows)
    on_maps = summary["scenario"].isin(list(MAPS))
    if on_maps.any():
        yield "maps", draw_maps(summary[on_maps])
        yield "roc", draw_roc(summary[on_maps])
    for scenario, stem in file_stems(summary.loc[~on_maps, "scenario"].unique()).items():
        yield f"detection-{stem}", draw_detection(summary[summary["scenario"] == scenario])


def draw_efficiency(summary: pd.DataFrame, scenario: str, looks: Mapping[Variant, LineLook]) -> Figure:
    """Draw errors compared with the Cramér-Rao bound, their ratio, misses and false points, over SNR.

    Parameters
    ----------
    summary : DataFrame
        As `isacbench.bench.studies.efficiency_study.summarise_efficiency` returns it.
    scenario : str
        Its name.
    looks : mapping of (str, str) to LineLook

    Returns
    -------
    Figure
    """
    part = summary[summary["scenario"] == scenario].sort_values("snr_gain_db")
    bound = Line2D([], [], color=BOUND_COLOUR, linestyle="--", label="Cramér-Rao bound")
    title = (
        f"{drawable(scenario)}: one scatterer, errors where it was found; "
        f"{trials_and_band(int(part['n_trials'].max()))}"
    )
    figure, panels = panel_grid(10, [*legend_lines(looks.values()), bound], title, max_columns=5)
    for dimension, errors, ratios in zip(DIMENSIONS, panels, panels[5:], strict=False):
        _draw_errors(errors, ratios, part, dimension, looks)
    missed, false = panels[4], panels[9]
    for axes, column in ((missed, "n_misses"), (false, "n_false")):
        for variant, look in looks.items():
            rows = rows_of(part, variant)
            share = rows[column] / rows["n_trials"]
            axes.plot(rows["snr_gain_db"], share, color=look.colour, linestyle=look.line, marker=look.marker)
    top = max(1.06 * float((part["n_false"] / part["n_trials"]).max()), MIN_FALSE_POINTS)
    missed.set(title="Missed", ylabel="share of trials", ylim=SHARE_LIMITS)
    false.set(title="False points", ylabel="number a trial", ylim=(-0.03 * top, top))
    for axes in panels:
        axes.grid(True)
        axes.set_xlim(part["snr_gain_db"].min() - 1, part["snr_gain_db"].max() + 1)
    for axes in panels[5:]:
        axes.set_xlabel("SNR after gain [dB]")
    return figure


def _draw_errors(
    errors: Axes, ratios: Axes, part: pd.DataFrame, dimension: str, looks: Mapping[Variant, LineLook]
) -> None:
    """Draw the errors of one dimension, and below them their ratio to the bound."""
    unit, axis_unit = UNITS[dimension]
    bounds = part.drop_duplicates("snr_gain_db")
    # One hit among many trials is no measurement.
    n_hits = part["n_trials"] - part["n_failed"] - part["n_misses"]
    is_measured = (n_hits > 1) | (part["n_trials"] == 1)
    ratio = part[[f"ratio_{dimension}{end}" for end in ("", "_low", "_high")]]
    ratio = ratio.set_axis(BAND, axis=1).where(is_measured)
    # Errors have the relative band of their ratio.
    error = ratio.div(ratio["value"], axis=0).mul(part[f"rmse_{unit}"], axis=0)
    errors.set(title=DIMENSION_TITLES[dimension], ylabel=f"root mean square error{axis_unit}", yscale="log")
    errors.plot(bounds["snr_gain_db"], bounds[f"bound_{unit}"], color=BOUND_COLOUR, linestyle="--")
    ratios.set(ylabel="error over bound", yscale="log")
    ratios.axhline(1.0, color=BOUND_COLOUR, linestyle="--")
    for axes, numbers in ((errors, error), (ratios, ratio)):
        for variant, look in looks.items():
            rows = rows_of(part, variant)
            draw_line(axes, look, rows["snr_gain_db"], *(numbers.loc[rows.index, name] for name in BAND))
    ratios.set(ylim=(0.7, LARGEST_RATIO), yticks=[1, 2, 5, 10])
    write_plain_numbers(ratios.yaxis)


def draw_resolution(summary: pd.DataFrame, looks: Mapping[Variant, LineLook]) -> Figure:
    """Draw the probability that a pair is found over its distance, a panel a dimension.

    Parameters
    ----------
    summary : DataFrame
        As `isacbench.bench.studies.resolution_study.summarise_resolution` returns it, of one template
        and SNR.
    looks : mapping of (str, str) to LineLook

    Returns
    -------
    Figure
    """
    dimensions = list(summary["dimension"].unique())
    styles = [
        Line2D([], [], color="0.4", linestyle="-", label="mean over relative phases"),
        Line2D([], [], color="0.4", linestyle="--", label="in phase at the aperture's centre"),
    ]
    title = (
        f"{drawable(summary['template'].iloc[0])}: two equal scatterers, each found within half "
        f"their distance, {summary['snr_gain_db'].iloc[0]:.4g} dB after gain; "
        f"{trials_and_band(int(summary['n_trials'].max()))}"
    )
    figure, panels = panel_grid(len(dimensions), [*legend_lines(looks.values()), *styles], title)
    for axes, dimension in zip(panels, dimensions, strict=True):
        part = summary[summary["dimension"] == dimension].sort_values("separation_cells")
        for variant, look in looks.items():
            rows = rows_of(part, variant)
            cells = rows["separation_cells"]
            draw_line(axes, look, cells, rows["resolved"], rows["resolved_low"], rows["resolved_high"])
            axes.plot(cells, rows["resolved_in_phase"], color=look.colour, linestyle="--")
        ticks = sorted(part["separation_cells"].unique())
        axes.set(
            xscale="log",
            xticks=ticks if len(ticks) <= MAX_TICKS else ticks[::2],
            ylim=SHARE_LIMITS,
            title=DIMENSION_TITLES[dimension],
            xlabel="distance [Rayleigh cells]",
            ylabel="share of pairs found",
        )
        write_plain_numbers(axes.xaxis)
        axes.grid(True)
    return figure


def draw_maps(summary: pd.DataFrame) -> Figure:
    """Draw probabilities of detection and of false alarm over SNR, a column a map.

    Parameters
    ----------
    summary : DataFrame
        As `isacbench.bench.studies.detection_study.summarise_detection` returns it, of maps.

    Returns
    -------
    Figure
    """
    rate = reference_rate(summary["pfa"])
    part = summary[summary["pfa"] == rate].sort_values("snr_gain_db")
    looks, names = _detector_looks(summary), list(summary["scenario"].unique())
    title = (
        f"Detectors on synthetic maps, nominal P_fa {rate:g}; {trials_and_band(int(part['n_cells'].max()))}"
    )
    legend = [*legend_lines(looks.values()), _nominal(), _known_noise()]
    figure, panels = panel_grid(2 * len(names), legend, title, max_columns=len(names))
    snr_db = np.linspace(part["snr_gain_db"].min(), part["snr_gain_db"].max(), 61)
    limit = known_noise_rate(snr_db, rate)
    for detected, false, name in zip(panels, panels[len(names) :], names, strict=False):
        for text, look in looks.items():
            rows = part[(part["scenario"] == name) & (part["detector"] == text)]
            _draw_rates(detected, false, look, rows["snr_gain_db"], rows)
        detected.plot(snr_db, limit, **LIMIT_LINE)
        detected.set(title=drawable(name), ylabel="probability of detection", ylim=SHARE_LIMITS)
        false.set(
            xlabel="SNR of a target in its cell [dB]", ylabel="probability of false alarm", yscale="log"
        )
        false.axhline(rate, color=BOUND_COLOUR, linestyle="--")
    for axes in panels:
        axes.grid(True)
    share_scale(panels[len(names) :], "y")
    return figure


def draw_roc(summary: pd.DataFrame) -> Figure:
    """Draw probability of detection over the measured one of false alarm, a column a map, a row an SNR.

    Parameters
    ----------
    summary : DataFrame
        As `isacbench.bench.studies.detection_study.summarise_detection` returns it, of maps.

    Returns
    -------
    Figure
    """
    looks, names = _detector_looks(summary), list(summary["scenario"].unique())
    snrs = nearest_values(sorted(summary["snr_gain_db"].unique()), ROC_SNRS_DB)
    title = "Detection over measured false alarms, a point a nominal P_fa"
    legend, places = [*legend_lines(looks.values()), _known_noise()], list(product(snrs, names))
    figure, panels = panel_grid(len(places), legend, title, max_columns=len(names))
    for axes, (snr_db, name) in zip(panels, places, strict=True):
        part = summary[(summary["snr_gain_db"] == snr_db) & (summary["scenario"] == name)].sort_values("pfa")
        for text, look in looks.items():
            rows = part[part["detector"] == text]
            rate = _shown_rate(rows)
            axes.plot(rate, rows["pd"], color=look.colour, linestyle=look.line, marker=look.marker)
        rates = np.geomspace(summary["pfa"].min() / 3, 0.3, 61)
        limits = [float(known_noise_rate(snr_db, rate)) for rate in rates.tolist()]
        axes.plot(rates, limits, **LIMIT_LINE)
        axes.set(title=f"{drawable(name)}, {snr_db:.4g} dB", ylabel="probability of detection")
        axes.set(xscale="log", ylim=SHARE_LIMITS)
        axes.grid(True)
    for axes in panels[-len(names) :]:
        axes.set_xlabel("probability of false alarm")
    share_scale(panels, "x")
    return figure


def draw_detection(summary: pd.DataFrame) -> Figure:
    """Draw the effect of detectors on estimators: deviation, detection and false alarms over SNR.

    Parameters
    ----------
    summary : DataFrame
        As `isacbench.bench.studies.detection_study.summarise_detection` returns it, of one scenario.

    Returns
    -------
    Figure
    """
    looks = assign_looks(entry_labels(summary), bounds=())
    part = summary.sort_values("snr_db")
    title = (
        f"{drawable(part['scenario'].iloc[0])}: {', '.join(part['estimator'].unique())} behind each "
        f"detector; {trials_and_band(int(part['n_cells'].max()))}"
    )
    figure, panels = panel_grid(3, [*legend_lines(looks.values()), _nominal()], title)
    images, detected, false = panels
    for variant, look in looks.items():
        rows = rows_of(part, variant)
        snr_db, mean, half = rows["snr_db"], rows["deviation_mean"], rows["deviation_band"]
        draw_line(images, look, snr_db, mean, (mean - half).clip(lower=mean / 10), mean + half)
        _draw_rates(detected, false, look, snr_db, rows)
    for rate in part["pfa"].unique():
        false.axhline(rate, color=BOUND_COLOUR, linestyle="--")
    images.set(title="Images", ylabel="imaging deviation", yscale="log")
    detected.set(title="Cells of scatterers", ylabel="probability of detection", ylim=SHARE_LIMITS)
    shown = pd.concat([_shown_rate(part).dropna(), part["pfa"]])
    # Whole decades around every rate, at least one.
    lowest, highest = np.floor(np.log10(shown.min() / 1.5)), np.ceil(np.log10(1.5 * shown.max()))
    false.set(
        title="Cells far from scatterers",
        ylabel="probability of false alarm",
        yscale="log",
        ylim=(10**lowest, 10**highest),
    )
    for axes in panels:
        axes.set_xlabel("SNR [dB]")
        axes.grid(True)
    return figure


def _known_noise() -> Line2D:
    """Legend entry of what a detector finds that knows the noise, in closed form."""
    return Line2D([], [], label="known noise (closed form)", **LIMIT_LINE)


def _nominal() -> Line2D:
    """Legend entry of nominal rates."""
    return Line2D([], [], color=BOUND_COLOUR, linestyle="--", label="nominal P_fa")


def _detector_looks(summary: pd.DataFrame) -> dict[str, LineLook]:
    """Looks of detectors by how the suite writes them, the same for every nominal rate."""
    texts = list(dict.fromkeys(summary["detector"]))
    return dict(zip(texts, assign_looks({(text, ""): text for text in texts}, ()).values(), strict=True))


def _draw_rates(
    detected: Axes, false: Axes, look: LineLook, snr_db: pd.Series[Any], rows: pd.DataFrame
) -> None:
    """Draw probabilities of detection and of false alarm over SNR, inside their bands."""
    draw_line(detected, look, snr_db, rows["pd"], rows["pd_low"], rows["pd_high"])
    draw_line(false, look, snr_db, _shown_rate(rows), rows["pfa_measured_low"], rows["pfa_measured_high"])


def _shown_rate(rows: pd.DataFrame) -> pd.Series[Any]:
    """Measured false-alarm rates for a logarithmic axis: none at all is a tenth of one."""
    return rows["pfa_measured"].clip(lower=LOWEST_RATE_SHARE / rows["n_clear"].clip(lower=1))
