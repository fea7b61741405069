"""Tables of the study ``link``: deviations of every signal, bit errors of every channel."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

from isacbench.bench.plan.labels import Variant, estimator_labels, variants_in
from isacbench.bench.studies.link_study import outside_interval, summarise_link
from isacbench.bench.studies.medians import TIME, median_times, time_words
from isacbench.files.escaping import counted
from isacbench.report.tables.image_tables import deviation_text
from isacbench.report.tables.run_tables import (
    Grid,
    batched,
    text_rows,
    trials_and_band,
    with_failures,
    written,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    import pandas as pd

SIGNALS_A_TABLE = 6
MODULATIONS_A_TABLE = 4
IMAGED = ["template", "estimator", "params"]
SIGNAL = ["sensing", "modulation", "division"]

Signal = tuple[str, str, str]
"""Sensing, modulation and division, empty where they do not matter."""

DIVISIONS = {"reciprocal": "reciprocal", "matched": "matched", "wiener": "Wiener"}
KNOWLEDGE = {"perfect": "channel known", "prs": "channel from PRS"}


def link_grids(records: pd.DataFrame) -> list[Grid]:
    """Lay out deviations, one table a scenario and estimator, and bit error rates, one a channel.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.

    Returns
    -------
    list of Grid
    """
    summary = summarise_link(records)
    of_user = summary["channel"] != ""
    times_s = median_times(records, IMAGED)[f"{TIME}_median"]
    return _sensed(summary[~of_user], times_s, time_words(records)) + _received(summary[of_user])


def signals_of_part(part: pd.DataFrame) -> list[Signal]:
    """List the signals of some rows.

    Parameters
    ----------
    part : DataFrame
        With the columns sensing, modulation and division.

    Returns
    -------
    list of (str, str, str)
        Each once, in order.
    """
    return list(part[SIGNAL].drop_duplicates().itertuples(index=False, name=None))


def signal_label(signal: Signal) -> str:
    """Name a signal for people.

    Parameters
    ----------
    signal : (str, str, str)

    Returns
    -------
    str

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
    """Name receivers for people by what they know, and by further parameters where two know the same.

    Parameters
    ----------
    part : DataFrame
        Rows of receivers.

    Returns
    -------
    dict of (str, str) to str
        By name and parameters.
    """
    params = {variant: json.loads(variant[1]) for variant in variants_in(part)}
    known = [own["knowledge"] for own in params.values()]
    return {
        variant: KNOWLEDGE[own["knowledge"]]
        + (f", order {own['time_order']}" if known.count(own["knowledge"]) > 1 else "")
        for variant, own in params.items()
    }


def _sensed(summary: pd.DataFrame, times_s: pd.Series[float], words: str) -> list[Grid]:
    """Deviations, signals over SNR, with the median time of a scenario's images."""
    labels = estimator_labels(variants_in(summary))
    found = []
    for key, part in summary.groupby(IMAGED, sort=False):
        template, *variant = map(str, key)
        title = (
            f"{template}, {labels[variant[0], variant[1]]}: mean imaging deviation by what is sensed with, "
            f"{trials_and_band(int(part['n_cells'].max()), 'interval')}"
        )
        title += written(1e3 * times_s.get(key, math.nan), f"; {words} {{:.1f}} ms")
        texts = text_rows(part.sort_values("snr_db"), ["snr_db"], SIGNAL, deviation_text)
        for signals in batched(signals_of_part(part), SIGNALS_A_TABLE):
            found.append(_over_snr(title, texts[signals], map(signal_label, signals)))
    return found


def _received(summary: pd.DataFrame) -> list[Grid]:
    """Bit error rates, modulations over SNR, one table a channel and receiver."""
    labels, outside = receiver_labels(summary), outside_interval(summary)
    found = []
    for key, part in summary.groupby(["channel", "estimator", "params"], sort=False):
        channel, *variant = map(str, key)
        title = (
            f"{channel}, {labels[variant[0], variant[1]]}: bit error rate (expected) | EVM [dB] | Gbit/s, "
            f"{counted(part['n_cells'].max(), 'frame')}"
        ) + _expectation(outside.reindex(part.index).dropna())
        texts = text_rows(part.sort_values("snr_db"), ["snr_db"], ["modulation"], _reception)
        for chosen in batched(part["modulation"].unique(), MODULATIONS_A_TABLE):
            found.append(_over_snr(title, texts[chosen], (one.upper() for one in chosen)))
    return found


def _over_snr(title: str, texts: pd.DataFrame, names: Iterable[str]) -> Grid:
    """Grid of texts over SNR."""
    rows = [[f"{snr_db:.4g}", *row] for snr_db, *row in texts.itertuples()]
    return Grid(title, ["SNR [dB]", *names], rows)


def _expectation(outside: pd.Series[bool]) -> str:
    """Say whether counts of errors are as expected; empty where nothing is known to expect."""
    if outside.empty:
        return ""
    if not outside.any():
        return "; all counts of errors within the family-wise 99 % interval"
    return f"; {int(outside.sum())} of {outside.size} counts of errors outside the family-wise 99 % interval"


def _reception(entry: pd.Series[Any]) -> str:
    """Bit error rate beside the expected one, EVM and rate; and what failed."""
    if math.isnan(entry["ber"]):
        return with_failures("", entry["n_failed"])
    expected = "-" if math.isnan(entry["ber_expected"]) else _rate(entry["ber_expected"])
    figures = f"{_rate(entry['ber'])} ({expected}) | {entry['evm_db']:z.1f} | {entry['rate_bps'] / 1e9:.2f}"
    return with_failures(figures, entry["n_failed"])


def _rate(rate: float) -> str:
    """Rate with two digits; what no frame will ever show is 0."""
    return f"{rate:.1e}".replace("e-0", "e-") if rate >= 1e-12 else "0"
