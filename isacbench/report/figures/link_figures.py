"""Figures of the study ``link``: bit errors beside imaging deviation, and the trade between the two."""

from __future__ import annotations

import dataclasses
import textwrap
from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator

from isacbench.bench.plan.labels import estimator_labels, rows_of, variants_in
from isacbench.bench.studies.link_study import summarise_link
from isacbench.link.waveform.qam import awgn_ber
from isacbench.report.drawing.label_layout import place_labels
from isacbench.report.drawing.panels import draw_line, legend_lines, panel_grid
from isacbench.report.drawing.style import BOUND_COLOUR, COLOURS, LineLook, drawable, file_stems
from isacbench.report.figures.curves import write_plain_numbers
from isacbench.report.tables.link_tables import DIVISIONS, SIGNAL, receiver_labels, signal_label
from isacbench.report.tables.run_tables import trials_and_band

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from isacbench.bench.store.run import Run
    from isacbench.report.drawing.style import LineStyle
    from isacbench.report.figures.curves import NamedFigure

MODULATION_COLOURS: dict[str, str] = dict(zip(("qpsk", "16qam", "64qam", "256qam"), COLOURS, strict=False))
DIVISION_LINES: dict[str, LineStyle] = {"": "-", "reciprocal": "-", "matched": "--", "wiener": ":"}
PRS_LOOK = LineLook(f"image, {signal_label(('prs', '', ''))}", BOUND_COLOUR, "D", "-.", is_bound=False)
CLOSED_FORM = LineLook("closed form in white noise", "0.4", "", ":", is_bound=True)
RECEIVER_LINES: tuple[LineStyle, ...] = ("-", "--", ":", "-.")

LOWEST_BER = 1e-6
"""A frame has a few million bits: fewer errors are not seen."""

TRADE_SNRS_DB = 0.0, 10.0, 20.0, 30.0
SNR_SIZE_PT, SNR_COLOUR = 6.0, "0.35"
SNR_OFFSETS_PT = [(x, y) for x in (0.0, 10.0, -10.0) for y in (8.0, -8.0, 16.0, -16.0)]
PANEL_IN = 3.1, 2.5
TITLE_WIDTH = 42


def link_figures(run: Run) -> Iterator[NamedFigure]:
    """Draw bit errors beside deviations of every scenario, and the trade between the two.

    Parameters
    ----------
    run : Run

    Yields
    ------
    stem : str
        Of the file.
    figure : Figure
    """
    summary = summarise_link(run.rows)
    templates = [name for name in summary["template"].unique() if name]
    for template, stem in file_stems(templates).items():
        yield f"link-{stem}", draw_link(summary, template)
        trade = draw_trade(summary, template)
        if trade is not None:
            yield f"trade-{stem}", trade


def draw_link(summary: pd.DataFrame, template: str) -> Figure:
    """Draw bit error rates over SNR, a panel a channel, above imaging deviations, a panel an estimator.

    Parameters
    ----------
    summary : DataFrame
        As `isacbench.bench.studies.link_study.summarise_link` returns it.
    template : str
        Name of the scenario.

    Returns
    -------
    Figure
    """
    received = summary[summary["channel"] != ""]
    sensed = summary[summary["template"] == template]
    channels, estimators = list(received["channel"].unique()), variants_in(sensed)
    n_columns = max(len(channels), len(estimators), 1)
    title = (
        f"{drawable(template)}: bit errors of the user above deviations of the image; "
        f"{trials_and_band(int(summary['n_cells'].max()))}"
    )
    n_panels = n_columns + len(estimators) if channels else len(estimators)
    figure, panels = panel_grid(
        n_panels, _legend(received, sensed), title, max_columns=n_columns, panel_in=PANEL_IN
    )
    above, below = (panels[:n_columns], panels[n_columns:]) if channels else ([], panels)
    for unused in above[len(channels) :]:
        unused.set_visible(False)
    for axes, channel in zip(above, channels, strict=False):
        axes.set_title(_wrapped(f"User behind {drawable(channel)}"))
        axes.set_ylabel("bit error rate")
        _draw_errors(axes, received[received["channel"] == channel])
    labels = estimator_labels(estimators)
    for axes, variant in zip(below, estimators, strict=True):
        axes.set_title(f"Image by {drawable(labels[variant])}")
        axes.set_ylabel("imaging deviation")
        _draw_deviations(axes, rows_of(sensed, variant))
    lowest, highest = summary["snr_db"].min(), summary["snr_db"].max()
    for axes in panels:
        axes.grid(True)
        axes.set_xlim(lowest - 1, highest + 1)
        axes.set_xlabel("SNR of a resource element [dB]")
    return figure


def draw_trade(summary: pd.DataFrame, template: str) -> Figure | None:
    """Draw imaging deviation over the bit rate that the user gets at the same SNR, a panel an estimator.

    Parameters
    ----------
    summary : DataFrame
        As `isacbench.bench.studies.link_study.summarise_link` returns it.
    template : str
        Name of the scenario.

    Returns
    -------
    Figure or None
        None where nothing was received, or nothing sensed with data.
    """
    received = summary[summary["channel"] != ""]
    sensed = summary[summary["template"] == template]
    if received.empty or sensed.empty:
        return None
    channel = received["channel"].iloc[0]
    of_channel = received[received["channel"] == channel]
    receiver, estimators = variants_in(of_channel)[-1], variants_in(sensed)
    rates = rows_of(of_channel, receiver)[["modulation", "snr_db", "rate_bps"]]
    labels, known = estimator_labels(estimators), receiver_labels(received)[receiver]
    title = f"{drawable(template)}: image against bit rate behind {drawable(channel)}, {known}"
    prs_look = dataclasses.replace(PRS_LOOK, colour="0.4")
    legend = [*_modulation_lines(rates["modulation"].unique()), *_sensing_lines(sensed, prs_look)]
    legend.append(_snr_entry())
    figure, panels = panel_grid(len(estimators), legend, title, panel_in=PANEL_IN)
    labels_of_panels = []
    for axes, variant in zip(panels, estimators, strict=True):
        points = _trade_points(rows_of(sensed, variant), rates)
        for key, path in points.groupby(SIGNAL, sort=False):
            sensing, modulation, division = map(str, key)
            look, colour = _signal_look(sensing, modulation, division), MODULATION_COLOURS[modulation]
            rate, deviation = path["rate_gbps"], path["deviation_mean"]
            axes.plot(rate, deviation, color=colour, linestyle=look.line, marker=look.marker)
        axes.set(title=f"Image by {drawable(labels[variant])}", xlabel="achievable bit rate [Gbit/s]")
        # Deviations far above 0 leave the automatic margin too narrow for a marker.
        axes.set(ylabel="imaging deviation", ylim=(0, 1.06 * axes.get_ylim()[1]))
        axes.grid(True)
        is_labelled = (points["sensing"] == "all") & points["division"].isin(["", "reciprocal"])
        labels_of_panels.append((axes, points[is_labelled]))
    figure.draw_without_rendering()  # labels take their places from the layout
    for axes, labelled in labels_of_panels:
        _write_snrs(axes, labelled)
    return figure


def _trade_points(part: pd.DataFrame, rates: pd.DataFrame) -> pd.DataFrame:
    """Deviations of one estimator and bit rates at the same SNR; those of the PRS for every modulation."""
    of_prs, part = part["sensing"] == "prs", part.drop(columns="rate_bps", errors="ignore")
    modulations = rates[["modulation"]].drop_duplicates()
    prs = part[of_prs].drop(columns="modulation").merge(modulations, how="cross")
    points = pd.concat([part[~of_prs], prs]).merge(rates, on=["modulation", "snr_db"])
    points = points[points["snr_db"].isin(TRADE_SNRS_DB)]
    path = points.groupby(SIGNAL, sort=False).ngroup()
    return points.assign(rate_gbps=points["rate_bps"] / 1e9, path=path).sort_values(["path", "snr_db"])


def _write_snrs(axes: Axes, points: pd.DataFrame) -> None:
    """Write SNRs beside points in their colours, none over another; one that has no room is left out."""
    points = points[np.isfinite(points["rate_gbps"] + points["deviation_mean"])]
    if points.empty:
        return
    places = points[["rate_gbps", "deviation_mean"]].to_numpy()
    texts = [f"{snr_db:g}" for snr_db in points["snr_db"]]
    sizes_pt = [(0.65 * SNR_SIZE_PT * len(text), 1.2 * SNR_SIZE_PT) for text in texts]
    places_pt = axes.transData.transform(places) * 72 / axes.figure.dpi
    offsets = place_labels(places_pt, sizes_pt, [SNR_OFFSETS_PT] * len(texts))
    for place, text, modulation, offset in zip(places, texts, points["modulation"], offsets, strict=True):
        if offset is not None:
            axes.annotate(
                text,
                tuple(place),
                textcoords="offset points",
                xytext=tuple(offset),
                fontsize=SNR_SIZE_PT,
                color=MODULATION_COLOURS[modulation],
                ha="center",
                va="center",
            )


def _wrapped(title: str) -> str:
    """Title of a panel, broken between words and parameters where it is wider than its panel."""
    return textwrap.fill(title.replace(",", ", "), TITLE_WIDTH, break_on_hyphens=False)


def _draw_errors(axes: Axes, part: pd.DataFrame) -> None:
    """Draw bit error rates behind a channel, and the closed form of white noise beside them."""
    snrs_db = np.linspace(part["snr_db"].min(), part["snr_db"].max(), 200)
    for modulation in part["modulation"].unique():
        colour = MODULATION_COLOURS[modulation]
        axes.plot(snrs_db, awgn_ber(modulation, snrs_db), color=colour, linestyle=CLOSED_FORM.line)
        for look, variant in zip(_receiver_looks(part, colour), variants_in(part), strict=True):
            rows = rows_of(part[part["modulation"] == modulation], variant).sort_values("snr_db")
            seen = rows[rows["n_bit_errors"] > 0]
            draw_line(axes, look, seen["snr_db"], seen["ber"], seen["ber_low"], seen["ber_high"])
    axes.set_yscale("log")
    axes.set_ylim(LOWEST_BER, 1)


def _draw_deviations(axes: Axes, part: pd.DataFrame) -> None:
    """Draw deviations of one estimator, every signal."""
    for key, rows in part.sort_values("snr_db", kind="stable").groupby(SIGNAL, sort=False):
        look = _signal_look(*map(str, key))
        mean, half = rows["deviation_mean"], rows["deviation_band"]
        low = (mean - half).clip(lower=mean / 10)
        draw_line(axes, look, rows["snr_db"], mean, low, mean + half, alpha=0.12)
    if (part["deviation_mean"] > 0).any():
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 1.5, 2, 3, 5, 7)))
        write_plain_numbers(axes.yaxis)


def _look(label: str, colour: str = "0.4", line: LineStyle = "-") -> LineLook:
    return LineLook(label, colour, "o", line, is_bound=False)


def _signal_look(sensing: str, modulation: str, division: str) -> LineLook:
    if sensing == "prs":
        return PRS_LOOK
    return _look(_division_label(division), MODULATION_COLOURS[modulation], DIVISION_LINES[division])


def _division_label(division: str) -> str:
    return f"image, {DIVISIONS.get(division, 'any')} division"


def _receiver_looks(received: pd.DataFrame, colour: str = "0.4") -> list[LineLook]:
    """Looks of receivers, a line each."""
    labels = receiver_labels(received).values()
    return [_look(f"bit errors, {name}", colour, line) for name, line in zip(labels, cycle(RECEIVER_LINES))]


def _legend(received: pd.DataFrame, sensed: pd.DataFrame) -> list[Line2D]:
    """Colours of modulations, lines of receivers, divisions and the PRS."""
    both = dict.fromkeys([*received["modulation"], *sensed["modulation"]])
    of_user = [] if received.empty else [*_receiver_looks(received), CLOSED_FORM]
    return [*_modulation_lines([one for one in both if one]), *legend_lines(of_user), *_sensing_lines(sensed)]


def _modulation_lines(modulations: Iterable[str]) -> list[Line2D]:
    return legend_lines(_look(one.upper(), MODULATION_COLOURS[one]) for one in modulations)


def _sensing_lines(sensed: pd.DataFrame, prs_look: LineLook = PRS_LOOK) -> list[Line2D]:
    """Lines of what is sensed with."""
    divisions = [one for one in dict.fromkeys(sensed["division"]) if one]
    looks = [_look(_division_label(one), line=DIVISION_LINES[one]) for one in divisions]
    return legend_lines([*looks, *([prs_look] if (sensed["sensing"] == "prs").any() else [])])


def _snr_entry() -> Line2D:
    """Legend entry of SNRs that are written beside points."""
    return Line2D(
        [],
        [],
        linestyle="",
        marker="$20$",
        markersize=6.0,
        markeredgewidth=0,
        color=SNR_COLOUR,
        label="SNR along solid lines [dB]",
    )
