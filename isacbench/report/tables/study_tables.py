"""Tables of the studies: efficiency, resolution and detection."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from isacbench.bench.cells.radio_coordinates import DIMENSIONS
from isacbench.bench.plan.labels import estimator_labels
from isacbench.bench.studies import detection_study, efficiency_study, resolution_study
from isacbench.bench.studies.medians import TIME, median_times
from isacbench.bench.studies.power_maps import MAPS
from isacbench.report.tables.run_tables import Grid, batched, milliseconds, trials_and_band

if TYPE_CHECKING:
    import pandas as pd

    from isacbench.bench.plan.labels import Variant

PAIRS_A_TABLE = 5
DETECTORS_A_TABLE = 6
IMAGERS_A_TABLE = 3
REFERENCE_PFA = 1e-3
"""Nominal rate whose numbers a table shows, where it was run: the paper's."""


def variants_in(table: pd.DataFrame) -> list[Variant]:
    """Names and parameters of a table's estimators, in order."""
    return list(dict.fromkeys(zip(table["estimator"], table["params"], strict=True)))


def efficiency_grids(records: pd.DataFrame) -> list[Grid]:
    """Lay out errors over the bound, one table a scenario and estimator."""
    summary = efficiency_study.summarise_efficiency(records)
    curve = ["scenario", "estimator", "params"]
    times_s = median_times(records, curve)[f"{TIME}_median"]
    labels = estimator_labels(variants_in(summary))
    found = []
    for (scenario, name, params), part in summary.groupby(curve, sort=False):
        rows = []
        for _, entry in part.sort_values("snr_gain_db").iterrows():
            failed = f" ({entry['n_failed']} failed)" if entry["n_failed"] else ""
            missed = f"{entry['n_misses'] / entry['n_trials']:.3f}{failed}"
            row = [f"{entry['snr_gain_db']:.4g}", missed, str(entry["n_false"])]
            rows.append(row + [_ratio(entry, dimension) for dimension in DIMENSIONS])
        title = (
            f"{scenario}, {labels[str(name), str(params)]}: error over Cramér-Rao bound, "
            f"{trials_and_band(int(part['n_trials'].max()), 'interval')}"
        )
        time_ms = milliseconds(times_s.get((scenario, name, params), math.nan))
        title += f"; median time {time_ms} ms" if time_ms else ""
        header = ["SNR: after gain [dB]", "missed", "false: points", *DIMENSIONS]
        found.append(Grid(title, header, rows))
    return found


def resolution_grids(records: pd.DataFrame) -> list[Grid]:
    """Lay out the share of pairs that were found, estimators over dimension and distance."""
    summary = resolution_study.summarise_resolution(records)
    place = ["template", "snr_gain_db"]
    times_s = median_times(records, [*place, "estimator", "params"])[f"{TIME}_median"]
    labels = estimator_labels(variants_in(summary))
    found = []
    for (template, snr_gain_db), part in summary.groupby(place, sort=False):
        title = (
            f"{template}, {snr_gain_db:.4g} dB after gain: share of pairs found, over all relative phases / "
            "at the worst one"
        )
        for variants in batched(variants_in(part), PAIRS_A_TABLE):
            header = ["pairs: differ in", "distance: cells", *(labels[variant] for variant in variants)]
            rows: list[list[str]] = []
            # A dimension is named where its rows start.
            for (dimension, cells), group in part.groupby(["dimension", "separation_cells"], sort=False):
                first = "" if any(row[0] == dimension for row in rows) else str(dimension)
                entries = {(row["estimator"], row["params"]): row for _, row in group.iterrows()}
                rows.append([first, f"{cells:g}", *(_shares(entries.get(variant)) for variant in variants)])
            keys = [(template, snr_gain_db, *variant) for variant in variants]
            times = [milliseconds(times_s.get(key, math.nan)) for key in keys]
            found.append(Grid(title, header, [*rows, ["time [ms]", "", *times]]))
    return found


def detection_grids(records: pd.DataFrame) -> list[Grid]:
    """Lay out probabilities of detection and of false alarm, detectors over SNR; deviations where imaged."""
    summary = detection_study.summarise_detection(records)
    found = []
    for scenario, whole in summary.groupby("scenario", sort=False):
        is_map = scenario in MAPS
        part = whole[whole["pfa"] == reference_rate(whole["pfa"])] if is_map else whole
        labels = entry_labels(part)
        if is_map:
            title = f"{scenario}: P_d and P_fa of a nominal {part['pfa'].iloc[0]:g}"
        else:
            title = f"{scenario}: deviation, P_d and P_fa of range-Doppler cells"
        for variants in batched(labels, DETECTORS_A_TABLE if is_map else IMAGERS_A_TABLE):
            header = ["SNR: after gain [dB]"] + ([] if is_map else ["SNR: an element [dB]"])
            rows = []
            for (gained, snr_db), group in part.sort_values("snr_db").groupby(["snr_gain_db", "snr_db"]):
                entries = {(row["estimator"], row["params"]): row for _, row in group.iterrows()}
                row = [f"{gained:.4g}"] if is_map else [f"{gained:.4g}", f"{snr_db:.1f}"]
                rows.append(row + [_detection(entries.get(variant), is_map) for variant in variants])
            found.append(Grid(title, header + [labels[variant] for variant in variants], rows))
    return found


def entry_labels(part: pd.DataFrame) -> dict[Variant, str]:
    """Label what ran on one map or scenario by its detector, and by its estimator if there are several."""
    several = part["estimator"].nunique() > 1 and not part["scenario"].isin(list(MAPS)).any()
    columns = zip(part["estimator"], part["params"], part["detector"], strict=True)
    return {(name, params): f"{name}, {text}" if several else text for name, params, text in columns}


def reference_rate(rates: pd.Series[Any]) -> float:
    """Nominal rate that stands for all: the paper's if it was run, otherwise the one nearest to it."""
    return float(min(rates.unique(), key=lambda rate: abs(math.log(rate / REFERENCE_PFA))))


def _ratio(entry: pd.Series[Any], dimension: str) -> str:
    """Error over bound with its interval, empty without a hit."""
    ratio, low, high = (entry[f"ratio_{dimension}{end}"] for end in ("", "_low", "_high"))
    if math.isnan(ratio):
        return ""
    return _short(ratio) + ("" if math.isnan(low) else f" ({_short(low)}-{_short(high)})")


def _short(ratio: float) -> str:
    """Two decimals, none from 10 on."""
    return f"{ratio:.2f}" if ratio < 9.995 else f"{ratio:.0f}"


def _shares(entry: pd.Series[Any] | None) -> str:
    """Share of resolved pairs, mean and worst phase, and what failed."""
    if entry is None:
        return ""
    failed = f" ({entry['n_failed']} failed)" if entry["n_failed"] else ""
    return f"{entry['resolved']:.2f} / {entry['resolved_worst']:.2f}{failed}"


def _detection(entry: pd.Series[Any] | None, is_map: bool) -> str:
    """Probabilities of detection and false alarm, after the deviation of an image."""
    if entry is None:
        return ""
    if entry["n_failed"]:
        return f"{entry['n_failed']} failed"
    rates = [_rate(entry["pd"], "{:.3f}"), _rate(entry["pfa_measured"], "{:.1e}")]
    return " ".join(rates if is_map else [f"{entry['deviation_mean']:.2f}", *rates])


def _rate(rate: float, form: str) -> str:
    """Measured rate; nothing was counted where an estimator does not show its map."""
    if math.isnan(rate):
        return "-"
    return form.format(rate).replace("e-0", "e-") if rate else "0"
