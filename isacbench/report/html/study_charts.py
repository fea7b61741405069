"""Charts of studies for a page: bit errors beside images, false-alarm rates, resolution, efficiency."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from isacbench.bench.plan.labels import estimator_labels, rows_of, variants_in
from isacbench.bench.studies.detection_study import summarise_detection
from isacbench.bench.studies.efficiency_study import summarise_efficiency
from isacbench.bench.studies.link_study import summarise_link
from isacbench.bench.studies.power_maps import MAPS
from isacbench.bench.studies.resolution_study import summarise_resolution
from isacbench.link.waveform.qam import awgn_ber
from isacbench.model.radio_coordinates import DIMENSIONS
from isacbench.report.drawing.style import COLOURS
from isacbench.report.figures.study_figures import DIMENSION_TITLES
from isacbench.report.html.page_file import numbers
from isacbench.report.tables.link_tables import SIGNAL, receiver_labels, signal_label
from isacbench.report.tables.study_tables import reference_rate

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from isacbench.report.html.joined_runs import JoinedRuns

    Chart = dict[str, Any]

DASHES = ("solid", "dash", "dot", "dashdot")
SYMBOLS = ("circle", "square", "triangle-up", "diamond", "triangle-down", "pentagon")
GAIN = "SNR after gain [dB]"
SHARE = [-0.03, 1.03]


def study_charts(joined: JoinedRuns) -> list[Chart]:
    """Lay out the charts of a study; images alone have none.

    Parameters
    ----------
    joined : JoinedRuns

    Returns
    -------
    list of dict
        Each with ``group`` and ``title``; ``x`` and ``y``, axes with ``title``, ``log`` and ``range``;
        ``series`` with ``label``, ``colour``, ``dash``, ``symbol`` and the lists ``x``, ``y``, ``low``,
        ``high``; and ``line``, a reference value of y, or None.
    """
    charts = CHARTS.get(joined.table.kind)
    return [] if charts is None else list(charts(joined.table.rows))


def _chart(group: str, title: str, x: str, y: str, series: list[dict[str, Any]], **more: Any) -> Chart:
    return {
        "group": group,
        "title": title,
        "x": {"title": x, "log": more.get("log_x", False)},
        "y": {"title": y, "log": more.get("log_y", False), "range": more.get("range")},
        "line": more.get("line"),
        "series": series,
    }


def _series(label: str, look: int, x: Any, y: Any, low: Any = None, high: Any = None, **more: Any) -> Any:
    """One line: numbers of colours repeat after six, with other dashes and symbols."""
    turn, index = divmod(look, len(COLOURS))
    found = {
        "label": label,
        "colour": more.get("colour", COLOURS[index]),
        "dash": more.get("dash", DASHES[turn % len(DASHES)]),
        "symbol": more.get("symbol", SYMBOLS[index]),
    }
    columns = {"x": x, "y": y, "low": low, "high": high}
    return found | {name: [] if values is None else numbers(values) for name, values in columns.items()}


def _link_charts(records: pd.DataFrame) -> Iterator[Chart]:
    """Bit error rates of every channel, then deviations of every scenario and estimator."""
    summary = summarise_link(records).sort_values("snr_db", kind="stable")
    received, sensed = summary[summary["channel"] != ""], summary[summary["channel"] == ""]
    snr = "SNR of a resource element [dB]"
    names = receiver_labels(received) if len(received) else {}
    colours = dict(zip(dict.fromkeys(summary["modulation"]), cycle(COLOURS), strict=False))
    for channel, part in received.groupby("channel", sort=False):
        series = []
        for modulation in dict.fromkeys(part["modulation"]):
            look = {"colour": colours[modulation]}
            own = part[part["modulation"] == modulation]
            for dash, (variant, name) in zip(DASHES, names.items(), strict=False):
                rows = rows_of(own, variant)
                seen = rows[rows["n_bit_errors"] > 0]
                label = f"{modulation.upper()}, {name}"
                errors = seen["ber"], seen["ber_low"], seen["ber_high"]
                series.append(_series(label, 0, seen["snr_db"], *errors, dash=dash, **look))
            snrs_db = np.unique(own["snr_db"])
            theory = awgn_ber(modulation, snrs_db)
            shown = np.where(theory >= LOWEST_BER, theory, np.nan)
            label = f"{modulation.upper()}, closed form in white noise"
            series.append(_series(label, 0, snrs_db, shown, dash="dot", symbol="", **look))
        title = f"User behind {channel}"
        yield _chart("Bit errors of the user", title, snr, "bit error rate", series, log_y=True)
    labels = estimator_labels(variants_in(sensed))
    for key, part in sensed.groupby(["template", "estimator", "params"], sort=False):
        template, name, params = map(str, key)
        series = []
        for number, (parts, rows) in enumerate(part.groupby(SIGNAL, sort=False)):
            mean, band = rows["deviation_mean"], rows["deviation_band"]
            sensing, modulation, division = map(str, parts)
            signal = signal_label((sensing, modulation, division))
            series.append(_series(signal, number, rows["snr_db"], mean, mean - band, mean + band))
        title = f"{template}, image by {labels[name, params]}"
        yield _chart("Images with the same frame", title, snr, "imaging deviation", series, log_y=True)


def _detection_charts(records: pd.DataFrame) -> Iterator[Chart]:
    """False alarms over their nominal rate and over SNR on every map, then behind estimators."""
    summary = summarise_detection(records)
    on_maps = summary[summary["scenario"].isin(list(MAPS))]
    for name, part in on_maps.groupby("scenario", sort=False):
        rate = reference_rate(part["pfa"])
        at_rate = part[part["pfa"] == rate]
        over = at_rate.sort_values("snr_gain_db")
        title, group = f"Map {name}, nominal P_fa {rate:g}", "Detectors on synthetic maps"
        yield _chart(
            group, title, GAIN, "false-alarm rate", _rates(over, "pfa_measured"), log_y=True, line=rate
        )
        yield _chart(group, title, GAIN, "probability of detection", _rates(over, "pd"), range=SHARE)
        if part["pfa"].nunique() > 1:
            highest = part["snr_gain_db"].max()
            own = part[part["snr_gain_db"] == highest].sort_values("pfa")
            series = _rates(own, "pfa_measured", "pfa")
            series.append(_series("nominal", 0, own["pfa"], own["pfa"], colour="", dash="dash", symbol=""))
            title = f"Map {name}, {highest:g} dB"
            yield _chart(group, title, "nominal P_fa", "false-alarm rate", series, log_x=True, log_y=True)
    for name, part in summary[~summary["scenario"].isin(list(MAPS))].groupby("scenario", sort=False):
        over, group = part.sort_values("snr_db"), f"Detectors in front of estimators on {name}"
        axis = "SNR [dB]"
        yield _chart(
            group,
            "Cells far from scatterers",
            axis,
            "false-alarm rate",
            _rates(over, "pfa_measured", "snr_db"),
            log_y=True,
        )
        yield _chart(
            group,
            "Cells of scatterers",
            axis,
            "probability of detection",
            _rates(over, "pd", "snr_db"),
            range=SHARE,
        )
        over = over.assign(
            deviation=over["deviation_mean"],
            deviation_low=over["deviation_mean"] - over["deviation_band"],
            deviation_high=over["deviation_mean"] + over["deviation_band"],
        )
        yield _chart(
            group, "Images", axis, "imaging deviation", _rates(over, "deviation", "snr_db"), log_y=True
        )


def _rates(part: pd.DataFrame, column: str, x: str = "snr_gain_db") -> list[Any]:
    """One series for each detector, and estimator behind it."""
    several = part["estimator"].nunique() > 1 and part["deviation_mean"].notna().any()
    by = ["detector", "estimator", "params"] if part["deviation_mean"].notna().any() else ["detector"]
    found = []
    for look, (key, rows) in enumerate(part.groupby(by, sort=False)):
        label = f"{key[1]} behind {key[0]}" if several else str(key[0])
        values = rows[column]
        if (
            column == "pfa_measured"
        ):  # none of so many cells: not drawn on a logarithmic axis, but its band is
            values = values.where(values > 0)
        found.append(_series(label, look, rows[x], values, rows[f"{column}_low"], rows[f"{column}_high"]))
    return found


def _resolution_charts(records: pd.DataFrame) -> Iterator[Chart]:
    """Share of pairs that are found over their distance, a chart a dimension."""
    summary = summarise_resolution(records).sort_values("separation_cells", kind="stable")
    keys = ["template", "snr_gain_db", "dimension"]
    for (template, snr_db, dimension), part in summary.groupby(keys, sort=False):
        series = []
        for look, (variant, label) in enumerate(estimator_labels(variants_in(part)).items()):
            rows = rows_of(part, variant)
            limits = rows["resolved_low"], rows["resolved_high"]
            series.append(_series(label, look, rows["separation_cells"], rows["resolved"], *limits))
        group = f"{template}: two equal scatterers, {snr_db:.4g} dB after gain"
        names = "distance [Rayleigh cells]", "share of pairs found"
        yield _chart(group, DIMENSION_TITLES[str(dimension)], *names, series, log_x=True, range=SHARE)


def _efficiency_charts(records: pd.DataFrame) -> Iterator[Chart]:
    """Errors over the Cramér-Rao bound, a chart a dimension, and the share of misses."""
    summary = summarise_efficiency(records).sort_values("snr_gain_db", kind="stable")
    for scenario, part in summary.groupby("scenario", sort=False):
        labels, group = estimator_labels(variants_in(part)), f"{scenario}: one scatterer"
        for name in DIMENSIONS:
            series = []
            for look, (variant, label) in enumerate(labels.items()):
                rows = rows_of(part, variant)
                ratios = (rows[f"ratio_{name}{end}"] for end in ("", "_low", "_high"))
                series.append(_series(label, look, rows["snr_gain_db"], *ratios))
            title = f"{DIMENSION_TITLES[name]}: error over the Cramér-Rao bound"
            yield _chart(group, title, GAIN, "error over bound", series, log_y=True, line=1.0)
        missed = []
        for look, (variant, label) in enumerate(labels.items()):
            rows = rows_of(part, variant)
            missed.append(_series(label, look, rows["snr_gain_db"], rows["n_misses"] / rows["n_trials"]))
        yield _chart(group, "Missed", GAIN, "share of trials", missed, range=SHARE)


LOWEST_BER = 1e-6
"""A frame has a few million bits: fewer errors are not seen."""

CHARTS: Mapping[str, Callable[[pd.DataFrame], Iterator[Chart]]] = {
    "link": _link_charts,
    "detection": _detection_charts,
    "resolution": _resolution_charts,
    "efficiency": _efficiency_charts,
}
