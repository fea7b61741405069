"""Figures of the studies: errors over their bound, probabilities of resolution, detection and false alarm."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, NullFormatter

from isacbench.bench.cells.radio_coordinates import DIMENSIONS
from isacbench.report.drawing.panels import draw_line, legend_lines, panel_grid
from isacbench.report.drawing.style import BOUND_COLOUR, assign_looks, drawable
from isacbench.report.tables.run_tables import trials_and_band
from isacbench.report.tables.study_tables import entry_labels, reference_rate

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from isacbench.bench.plan.labels import Variant
    from isacbench.report.drawing.style import LineLook

TITLES = {"range": "Range", "velocity": "Velocity", "u": "Direction cosine u", "w": "Direction cosine w"}
UNITS = {"range": " [m]", "velocity": " [m/s]", "u": "", "w": ""}
COLUMNS = {"range": "range_m", "velocity": "velocity_mps", "u": "u", "w": "w"}

GAINED_SNR = "SNR after gain [dB]"
ROC_SNRS_DB = 10.0, 15.0, 20.0

LARGEST_RATIO = 10.0
"""Errors so many times the bound are far from it, however far."""

MIN_FALSE_POINTS = 0.1
"""Fewer false points a trial do not stretch their axis."""

LOWEST_RATE_SHARE = 0.1
"""Share of one false alarm of all clear cells at which a count of none is drawn on a logarithmic axis."""


def draw_efficiency(summary: pd.DataFrame, scenario: str, looks: Mapping[Variant, LineLook]) -> Figure:
    """Draw errors beside the Cramér-Rao bound, their ratio, and what was missed and false, over SNR.

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
    bounds = part.drop_duplicates("snr_gain_db")
    for index, dimension in enumerate(DIMENSIONS):
        errors, ratios = panels[index], panels[5 + index]
        column = COLUMNS[dimension]
        errors.set_title(TITLES[dimension])
        errors.set_ylabel(f"root mean square error{UNITS[dimension]}")
        errors.set_yscale("log")
        errors.plot(bounds["snr_gain_db"], bounds[f"bound_{column}"], color=BOUND_COLOUR, linestyle="--")
        ratios.set_ylabel("error over bound")
        ratios.set_yscale("log")
        ratios.axhline(1.0, color=BOUND_COLOUR, linestyle="--")
        for variant, look in looks.items():
            rows = _of(part, variant)
            snr_db, ratio = rows["snr_gain_db"], rows[f"ratio_{dimension}"]
            low, high = rows[f"ratio_{dimension}_low"], rows[f"ratio_{dimension}_high"]
            # One hit among many trials is no measurement.
            n_hits = rows["n_trials"] - rows["n_failed"] - rows["n_misses"]
            ratio = ratio.where((n_hits > 1) | (rows["n_trials"] == 1))
            draw_line(ratios, look, snr_db, ratio, low, high)
            # Errors have the relative band of their ratio.
            rmse = rows[f"rmse_{column}"].where(ratio.notna())
            draw_line(errors, look, snr_db, rmse, rmse * low / ratio, rmse * high / ratio)
        ratios.set_ylim(0.7, LARGEST_RATIO)
        ratios.set_yticks([1, 2, 5, 10])
        ratios.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ratios.yaxis.set_minor_formatter(NullFormatter())
    missed, false = panels[4], panels[9]
    missed.set_title("Missed")
    missed.set_ylabel("share of trials")
    missed.set_ylim(-0.03, 1.03)
    false.set_title("False points")
    false.set_ylabel("number a trial")
    for variant, look in looks.items():
        rows = _of(part, variant)
        for axes, column in ((missed, "n_misses"), (false, "n_false")):
            share = rows[column] / rows["n_trials"]
            axes.plot(rows["snr_gain_db"], share, color=look.colour, linestyle=look.line, marker=look.marker)
    top = max(1.06 * float((part["n_false"] / part["n_trials"]).max()), MIN_FALSE_POINTS)
    false.set_ylim(-0.03 * top, top)
    for axes in panels:
        axes.grid(True)
        axes.set_xlim(part["snr_gain_db"].min() - 1, part["snr_gain_db"].max() + 1)
    for axes in panels[5:]:
        axes.set_xlabel(GAINED_SNR)
    return figure


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
            rows = _of(part, variant)
            cells = rows["separation_cells"]
            draw_line(axes, look, cells, rows["resolved"], rows["resolved_low"], rows["resolved_high"])
            axes.plot(cells, rows["resolved_in_phase"], color=look.colour, linestyle="--")
        axes.set_xscale("log")
        ticks = sorted(part["separation_cells"].unique())
        axes.set_xticks(ticks if len(ticks) <= 5 else _thinned(ticks))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_ylim(-0.03, 1.03)
        axes.set_title(TITLES[dimension])
        axes.set_xlabel("distance [Rayleigh cells]")
        axes.set_ylabel("share of pairs found")
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
    part = summary[summary["pfa"] == rate]
    looks, names = _detector_looks(part), list(part["scenario"].unique())
    nominal = Line2D([], [], color=BOUND_COLOUR, linestyle="--", label="nominal P_fa")
    n_trials = int(part["n_cells"].max())
    title = f"Detectors on synthetic maps, nominal P_fa {rate:g}; {trials_and_band(n_trials)}"
    figure, panels = panel_grid(
        2 * len(names), [*legend_lines(looks.values()), nominal], title, max_columns=len(names)
    )
    for index, name in enumerate(names):
        detected, false = panels[index], panels[len(names) + index]
        detected.set_title(drawable(name))
        _draw_rates(detected, part[part["scenario"] == name], looks, "pd")
        _draw_rates(false, part[part["scenario"] == name], looks, "pfa_measured")
        detected.set_ylabel("probability of detection")
        false.axhline(rate, color=BOUND_COLOUR, linestyle="--")
        false.set_xlabel("SNR of a target in its cell [dB]")
        false.set_ylabel("probability of false alarm")
    _share_limits(panels[len(names) :])
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
    run = sorted(summary["snr_gain_db"].unique())
    snrs = list(dict.fromkeys(min(run, key=lambda value: abs(value - wanted)) for wanted in ROC_SNRS_DB))
    title = "Detection over measured false alarms, a point a nominal P_fa"
    figure, panels = panel_grid(
        len(snrs) * len(names), legend_lines(looks.values()), title, max_columns=len(names)
    )
    for place, axes in enumerate(panels):
        row, column = divmod(place, len(names))
        chosen = (summary["snr_gain_db"] == snrs[row]) & (summary["scenario"] == names[column])
        part = summary[chosen].sort_values("pfa")
        for text, look in looks.items():
            rows = part[part["detector"] == text]
            axes.plot(
                _shown_rate(rows), rows["pd"], color=look.colour, linestyle=look.line, marker=look.marker
            )
        axes.set_xscale("log")
        axes.set_ylim(-0.03, 1.03)
        axes.set_title(f"{drawable(names[column])}, {snrs[row]:.4g} dB")
        axes.set_ylabel("probability of detection")
        axes.grid(True)
        if row == len(snrs) - 1:
            axes.set_xlabel("probability of false alarm")
    lower, upper = np.transpose([axes.get_xlim() for axes in panels])
    for axes in panels:
        axes.set_xlim(lower.min(), upper.max())
    return figure


def draw_detection(summary: pd.DataFrame) -> Figure:
    """Draw what detectors are worth to estimators: deviation, detection and false alarms over SNR.

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
    nominal = Line2D([], [], color=BOUND_COLOUR, linestyle="--", label="nominal P_fa")
    figure, panels = panel_grid(3, [*legend_lines(looks.values()), nominal], title)
    titles = {
        "Images": "imaging deviation",
        "Cells of scatterers": "probability of detection",
        "Cells far from scatterers": "probability of false alarm",
    }
    for axes, (name, drawn) in zip(panels, titles.items(), strict=True):
        axes.set_title(name)
        axes.set_ylabel(drawn)
        axes.set_xlabel("SNR [dB]")
        axes.grid(True)
    for variant, look in looks.items():
        rows = _of(part, variant)
        mean, half = rows["deviation_mean"], rows["deviation_band"]
        draw_line(panels[0], look, rows["snr_db"], mean, (mean - half).clip(lower=mean / 10), mean + half)
        draw_line(panels[1], look, rows["snr_db"], rows["pd"], rows["pd_low"], rows["pd_high"])
        shown = _shown_rate(rows)
        draw_line(panels[2], look, rows["snr_db"], shown, rows["pfa_measured_low"], rows["pfa_measured_high"])
    panels[0].set_yscale("log")
    panels[1].set_ylim(-0.03, 1.03)
    panels[2].set_yscale("log")
    for rate in part["pfa"].unique():
        panels[2].axhline(rate, color=BOUND_COLOUR, linestyle="--")
    shown = pd.concat([_shown_rate(part).dropna(), part["pfa"]])
    # Whole decades around every rate, at least one.
    lowest, highest = np.floor(np.log10(shown.min() / 1.5)), np.ceil(np.log10(1.5 * shown.max()))
    panels[2].set_ylim(10**lowest, 10**highest)
    return figure


def _of(part: pd.DataFrame, variant: Variant) -> pd.DataFrame:
    """Rows of one estimator."""
    return part[(part["estimator"] == variant[0]) & (part["params"] == variant[1])]


def _detector_looks(summary: pd.DataFrame) -> dict[str, LineLook]:
    """Looks of detectors by how the suite writes them, the same for every nominal rate."""
    texts = list(dict.fromkeys(summary["detector"]))
    return dict(zip(texts, assign_looks({(text, ""): text for text in texts}, ()).values(), strict=True))


def _draw_rates(axes: Axes, part: pd.DataFrame, looks: Mapping[str, LineLook], name: str) -> None:
    """Draw a probability over SNR, every detector, inside its band."""
    part = part.sort_values("snr_gain_db")
    for text, look in looks.items():
        rows = part[part["detector"] == text]
        values = rows[name] if name == "pd" else _shown_rate(rows)
        draw_line(axes, look, rows["snr_gain_db"], values, rows[f"{name}_low"], rows[f"{name}_high"])
    axes.grid(True)
    if name == "pd":
        axes.set_ylim(-0.03, 1.03)
    else:
        axes.set_yscale("log")


def _shown_rate(rows: pd.DataFrame) -> pd.Series[Any]:
    """Measured false-alarm rates for a logarithmic axis: none at all is a tenth of one."""
    return rows["pfa_measured"].clip(lower=LOWEST_RATE_SHARE / rows["n_clear"].clip(lower=1))


def _share_limits(panels: Sequence[Axes]) -> None:
    """Put panels on one vertical scale."""
    lower, upper = np.transpose([axes.get_ylim() for axes in panels])
    for axes in panels:
        axes.set_ylim(lower.min(), upper.max())


def _thinned(ticks: Sequence[float]) -> list[float]:
    """Every second of many ticks."""
    return list(ticks[::2])
