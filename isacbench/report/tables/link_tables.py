"""Tables of the study ``link``: deviations of every signal, bit errors of every channel."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

from isacbench.bench.plan.labels import Variant, estimator_labels
from isacbench.bench.studies.link_study import outside_interval, summarise_link
from isacbench.bench.studies.medians import TIME, median_times
from isacbench.files.escaping import counted
from isacbench.report.tables.run_tables import Grid, batched, milliseconds, trials_and_band

if TYPE_CHECKING:
    import pandas as pd

SIGNALS_A_TABLE = 6
MODULATIONS_A_TABLE = 4
IMAGED = ["template", "estimator", "params"]

Signal = tuple[str, str, str]
"""Sensing, modulation and division, empty where they do not matter."""

DIVISIONS = {"reciprocal": "reciprocal", "matched": "matched", "wiener": "Wiener"}
KNOWLEDGE = {"perfect": "channel known", "prs": "channel from PRS"}


def link_grids(records: pd.DataFrame) -> list[Grid]:
    """Lay out deviations, one table a scenario and estimator, and bit error rates, one a channel."""
    summary = summarise_link(records)
    of_user = summary["channel"] != ""
    times_s = median_times(records, IMAGED)[f"{TIME}_median"]
    return _sensed(summary[~of_user], times_s) + _received(summary[of_user])


def signals_of_part(part: pd.DataFrame) -> list[Signal]:
    """Signals of some rows, in order."""
    columns = zip(part["sensing"], part["modulation"], part["division"], strict=True)
    return list(dict.fromkeys(columns))


def signal_label(signal: Signal) -> str:
    """Name a signal for people.

    Examples
    --------
    >>> signal_label(("all", "16qam", "matched")), signal_label(("prs", "", ""))
    ('16QAM, matched', 'PRS alone')
    """
    sensing, modulation, division = signal
    if sensing == "prs":
        return "PRS alone"
    return modulation.upper() + (f", {DIVISIONS[division]}" if division else "")


def receiver_labels(part: pd.DataFrame) -> dict[Variant, str]:
    """Name receivers for people by what they know, and by further parameters where two know the same."""
    variants = list(dict.fromkeys(zip(part["estimator"], part["params"], strict=True)))
    params = {variant: json.loads(variant[1]) for variant in variants}
    labels = {}
    for variant, own in params.items():
        label = KNOWLEDGE[own["knowledge"]]
        if sum(other["knowledge"] == own["knowledge"] for other in params.values()) > 1:
            label += f", order {own['time_order']}"
        labels[variant] = label
    return labels


def _sensed(summary: pd.DataFrame, times_s: pd.Series[float]) -> list[Grid]:
    """Deviations, signals over SNR, with the median time of a scenario's images."""
    labels = estimator_labels(zip(summary["estimator"], summary["params"], strict=True))
    found = []
    for (template, name, params), part in summary.groupby(IMAGED, sort=False):
        title = (
            f"{template}, {labels[str(name), str(params)]}: mean imaging deviation by what is sensed with, "
            f"{trials_and_band(int(part['n_cells'].max()), 'interval')}"
        )
        time_ms = milliseconds(times_s.get((template, name, params), math.nan))
        title += f"; median time {time_ms} ms" if time_ms else ""
        for signals in batched(signals_of_part(part), SIGNALS_A_TABLE):
            rows = []
            for snr_db, group in part.sort_values("snr_db").groupby("snr_db"):
                entries = {
                    (row["sensing"], row["modulation"], row["division"]): row for _, row in group.iterrows()
                }
                rows.append([f"{snr_db:.4g}", *(_deviation(entries.get(signal)) for signal in signals)])
            found.append(Grid(title, ["SNR [dB]", *map(signal_label, signals)], rows))
    return found


def _deviation(entry: pd.Series[Any] | None) -> str:
    """Mean deviation with its band, and what failed."""
    if entry is None:
        return ""
    failed = f" ({entry['n_failed']} failed)" if entry["n_failed"] else ""
    if math.isnan(entry["deviation_mean"]):
        return failed.strip()
    band = "" if math.isnan(entry["deviation_band"]) else f" ± {entry['deviation_band']:.2f}"
    return f"{entry['deviation_mean']:.2f}{band}{failed}"


def _received(summary: pd.DataFrame) -> list[Grid]:
    """Bit error rates, modulations over SNR, one table a channel and receiver."""
    labels, outside = receiver_labels(summary), outside_interval(summary)
    found = []
    for (channel, name, params), part in summary.groupby(["channel", "estimator", "params"], sort=False):
        title = (
            f"{channel}, {labels[str(name), str(params)]}: bit error rate (expected) | EVM [dB] | Gbit/s, "
            f"{counted(part['n_cells'].max(), 'frame')}"
        ) + _held(outside.reindex(part.index).dropna())
        modulations = list(part["modulation"].unique())
        for chosen in batched(modulations, MODULATIONS_A_TABLE):
            rows = []
            for snr_db, group in part.sort_values("snr_db").groupby("snr_db"):
                entries = {row["modulation"]: row for _, row in group.iterrows()}
                rows.append([f"{snr_db:.4g}", *(_reception(entries.get(one)) for one in chosen)])
            found.append(Grid(title, ["SNR [dB]", *(one.upper() for one in chosen)], rows))
    return found


def _held(outside: pd.Series[bool]) -> str:
    """Whether counts of errors are as expected, empty where none can be held against anything."""
    if outside.empty:
        return ""
    if not outside.any():
        return "; all counts of errors within the family-wise 99 % interval"
    return f"; {int(outside.sum())} of {outside.size} counts of errors outside the family-wise 99 % interval"


def _reception(entry: pd.Series[Any] | None) -> str:
    """Bit error rate beside the expected one, EVM and rate; and what failed."""
    if entry is None:
        return ""
    failed = f" ({entry['n_failed']} failed)" if entry["n_failed"] else ""
    if math.isnan(entry["ber"]):
        return failed.strip()
    expected = "-" if math.isnan(entry["ber_expected"]) else _rate(entry["ber_expected"])
    figures = f"{_rate(entry['ber'])} ({expected}) | {entry['evm_db']:z.1f} | {entry['rate_bps'] / 1e9:.2f}"
    return figures + failed


def _rate(rate: float) -> str:
    """Rate with two digits; what no frame will ever show is 0."""
    return f"{rate:.1e}".replace("e-0", "e-") if rate >= 1e-12 else "0"
