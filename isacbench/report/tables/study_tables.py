"""Tables of the studies: efficiency, resolution and detection."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from isacbench.bench.plan.labels import estimator_labels, variants_in
from isacbench.bench.studies.detection_study import summarise_detection
from isacbench.bench.studies.efficiency_study import summarise_efficiency
from isacbench.bench.studies.medians import TIME, median_times, time_words
from isacbench.bench.studies.power_maps import MAPS
from isacbench.bench.studies.resolution_study import summarise_resolution
from isacbench.model.radio_coordinates import DIMENSIONS
from isacbench.report.tables.run_tables import (
    Grid,
    batched,
    milliseconds,
    text_rows,
    trials_and_band,
    with_failures,
    written,
)

if TYPE_CHECKING:
    import pandas as pd

    from isacbench.bench.plan.labels import Variant

PAIRS_A_TABLE = 5
DETECTORS_A_TABLE = 6
IMAGERS_A_TABLE = 3
REFERENCE_PFA = 1e-3
"""Nominal rate whose numbers a table shows, where it was run: the paper's."""

VARIANT = ["estimator", "params"]


def efficiency_grids(records: pd.DataFrame) -> list[Grid]:
    """Lay out errors over the bound, one table a scenario and estimator.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.

    Returns
    -------
    list of Grid
    """
    summary = summarise_efficiency(records)
    curve = ["scenario", *VARIANT]
    times_s = median_times(records, curve)[f"{TIME}_median"]
    labels = estimator_labels(variants_in(summary))
    header = ["SNR: after gain [dB]", "missed", "false: points", *DIMENSIONS]
    found = []
    for key, part in summary.groupby(curve, sort=False):
        scenario, *variant = map(str, key)
        band = trials_and_band(int(part["n_trials"].max()), "interval")
        title = f"{scenario}, {labels[variant[0], variant[1]]}: error over Cramér-Rao bound, {band}"
        title += written(1e3 * times_s.get(key, math.nan), f"; {time_words(records)} {{:.1f}} ms")
        rows = [
            [
                f"{entry['snr_gain_db']:.4g}",
                with_failures(f"{entry['n_misses'] / entry['n_trials']:.3f}", entry["n_failed"]),
                str(entry["n_false"]),
                *(_ratio(entry, dimension) for dimension in DIMENSIONS),
            ]
            for _, entry in part.sort_values("snr_gain_db").iterrows()
        ]
        found.append(Grid(title, header, rows))
    return found


def resolution_grids(records: pd.DataFrame) -> list[Grid]:
    """Lay out the share of pairs that were found, estimators over dimension and distance.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.

    Returns
    -------
    list of Grid
        One a template and SNR, or more where the estimators are many.
    """
    summary = summarise_resolution(records)
    place = ["template", "snr_gain_db"]
    times_s = median_times(records, [*place, *VARIANT])[f"{TIME}_median"]
    labels = estimator_labels(variants_in(summary))
    found = []
    for key, part in summary.groupby(place, sort=False):
        title = (
            f"{key[0]}, {key[1]:.4g} dB after gain: share of pairs found, over all relative phases / "
            f"at the worst one; {time_words(records)}"
        )
        texts = text_rows(part, ["dimension", "separation_cells"], VARIANT, _shares)
        # A dimension is named where its rows start.
        dimensions = texts.index.get_level_values(0).to_series().where(lambda names: ~names.duplicated(), "")
        distances = [f"{cells:g}" for _, cells in texts.index]
        for variants in batched(variants_in(part), PAIRS_A_TABLE):
            header = ["pairs: differ in", "distance: cells", *(labels[variant] for variant in variants)]
            shares = texts[variants].to_numpy().tolist()
            rows = [[*row[:2], *row[2]] for row in zip(dimensions, distances, shares, strict=True)]
            times = [milliseconds(times_s.get((*key, *variant), math.nan)) for variant in variants]
            found.append(Grid(title, header, [*rows, ["time [ms]", "", *times]]))
    return found


def detection_grids(records: pd.DataFrame) -> list[Grid]:
    """Lay out probabilities of detection and of false alarm over SNR, and deviations where imaged.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.

    Returns
    -------
    list of Grid
        One a map or scenario, or more where the detectors are many.
    """
    summary = summarise_detection(records)
    found = []
    for scenario, part in summary.groupby("scenario", sort=False):
        is_map = scenario in MAPS
        if is_map:
            part = part[part["pfa"] == reference_rate(part["pfa"])]
            title = f"{scenario}: P_d and P_fa of a nominal {part['pfa'].iloc[0]:g}"
            write, header, n_columns = _rates, ["SNR: after gain [dB]"], DETECTORS_A_TABLE
        else:
            title = f"{scenario}: deviation, P_d and P_fa of range-Doppler cells"
            write, header, n_columns = (
                _deviation_and_rates,
                ["SNR: after gain [dB]", "SNR: an element [dB]"],
                IMAGERS_A_TABLE,
            )
        labels = entry_labels(part)
        texts = text_rows(part.sort_values("snr_db"), ["snr_gain_db", "snr_db"], VARIANT, write)
        snrs = [[f"{gained:.4g}", f"{snr_db:.1f}"][: len(header)] for gained, snr_db in texts.index]
        for variants in batched(labels, n_columns):
            rows = [[*snr, *row] for snr, row in zip(snrs, texts[variants].to_numpy().tolist(), strict=True)]
            found.append(Grid(title, header + [labels[variant] for variant in variants], rows))
    return found


def entry_labels(part: pd.DataFrame) -> dict[Variant, str]:
    """Label what ran on one map or scenario by its detector, and by its estimator if there are several.

    Parameters
    ----------
    part : DataFrame
        Rows of one map or scenario, or of several maps.

    Returns
    -------
    dict of (str, str) to str
        By name and parameters.
    """
    several = part["estimator"].nunique() > 1 and not part["scenario"].isin(list(MAPS)).any()
    columns = zip(part["estimator"], part["params"], part["detector"], strict=True)
    return {(name, params): f"{name}, {text}" if several else text for name, params, text in columns}


def reference_rate(rates: pd.Series[Any]) -> float:
    """Select the nominal rate that is shown: the paper's if it was run, otherwise the one nearest to it.

    Parameters
    ----------
    rates : Series of float

    Returns
    -------
    float
    """
    return float(min(rates.unique(), key=lambda rate: abs(math.log(rate / REFERENCE_PFA))))


def _ratio(entry: pd.Series[Any], dimension: str) -> str:
    """Error over bound with its interval, empty without a hit."""
    ratio, low, high = (_short(entry[f"ratio_{dimension}{end}"]) for end in ("", "_low", "_high"))
    return f"{ratio} ({low}-{high})" if low else ratio


def _short(ratio: float) -> str:
    """Two decimals, none from 10 on."""
    return written(ratio, "{:.2f}" if ratio < 9.995 else "{:.0f}")


def _shares(entry: pd.Series[Any]) -> str:
    """Share of resolved pairs, mean and worst phase, and what failed."""
    return with_failures(f"{entry['resolved']:.2f} / {entry['resolved_worst']:.2f}", entry["n_failed"])


def _rates(entry: pd.Series[Any]) -> str:
    """Probabilities of detection and false alarm."""
    if entry["n_failed"]:
        return with_failures("", entry["n_failed"])
    return f"{_rate(entry['pd'], '{:.3f}')} {_rate(entry['pfa_measured'], '{:.1e}')}"


def _deviation_and_rates(entry: pd.Series[Any]) -> str:
    """Deviation, and the probabilities of detection and false alarm."""
    return _rates(entry) if entry["n_failed"] else f"{entry['deviation_mean']:.2f} {_rates(entry)}"


def _rate(rate: float, form: str) -> str:
    """Measured rate; nothing was counted where an estimator does not show its map."""
    if math.isnan(rate):
        return "-"
    return form.format(rate).replace("e-0", "e-") if rate else "0"
