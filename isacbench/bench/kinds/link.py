"""The kind ``link``: one frame that is sensed with and that a user receives, bit errors beside images.

Two sorts of rows. Those of a scenario are ordinary ones of estimators, which
image the echo of a frame: of all its resource elements or of the PRS alone,
its data of some modulation, divided by what was sent in some way. Those of a
user are of a receiver, which has no cloud and no scores: bits, and how many
of them came out wrong.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, ClassVar, get_args

import numpy as np
import pandas as pd
from scipy.special import bdtr, bdtrc

from isacbench import charts
from isacbench.bench import statistics
from isacbench.bench.cells.record import failed
from isacbench.bench.kinds import kind
from isacbench.bench.kinds.imaging import deviation_text
from isacbench.bench.kinds.kind import NO_SCENARIOS, SNR_GAIN, Kind, Scenarios
from isacbench.bench.kinds.link_scenes import LinkSuite, plan_scenes
from isacbench.bench.kinds.scenes import Task
from isacbench.charts import VARIANT, Axis, Chart, ChartGroup, Column, LineStyle, Series, Table, Variant
from isacbench.choices import Modulation
from isacbench.files.escaping import counted
from isacbench.link.waveform.qam import awgn_ber

IMAGED = ["template", *VARIANT]
SIGNAL = ["sensing", "modulation", "division"]
GROUP = ["scenario", "template", "modulation", "sensing", "division", "channel", *VARIANT, "snr_db"]

FAMILY_CONFIDENCE = 0.99
"""Confidence of the interval that all counts of bit errors of a run are compared with together."""

SIGNALS_A_TABLE, MODULATIONS_A_TABLE = 6, 4
DIVISIONS = {"reciprocal": "reciprocal", "matched": "matched", "wiener": "Wiener"}
KNOWLEDGE = {"perfect": "channel known", "prs": "channel from PRS"}

MODULATION_COLOURS = dict(zip(get_args(Modulation), charts.COLOURS, strict=False))
DIVISION_DASHES = {"": "solid", "reciprocal": "solid", "matched": "dash", "wiener": "dot"}
RECEIVER_DASHES = "solid", "dash", "dashdot"
PRS_STYLE = LineStyle("", "dashdot", "diamond")

LOWEST_BER = 1e-6
"""A frame has a few million bits: fewer errors are not seen."""

TRADE_SNRS_DB = 0.0, 10.0, 20.0, 30.0
SNR_AXIS = Axis("SNR of a resource element [dB]")
PANEL_IN = 3.1, 2.5


class LinkKind(Kind):
    """Bit errors of a user, and deviations of images from the same frame."""

    name = "link"
    suite = LinkSuite
    columns: ClassVar = {
        **SNR_GAIN,
        **dict.fromkeys(["template", "modulation", "sensing", "division", "channel"], ""),
        **dict.fromkeys(["n_bits", "n_bit_errors"], 0),
        **dict.fromkeys(["ber_expected", "evm_db", "channel_error_db", "rate_bps"], math.nan),
    }
    better: ClassVar = {
        "rate_bps": "higher",
        **dict.fromkeys(["snr_gain_db", "n_bits", "ber_expected"], "neither"),
    }

    def scenes(self, suite: LinkSuite, scenarios: Scenarios) -> list[Task]:
        """Plan every scenario with every signal, and every channel with every modulation."""
        return plan_scenes(suite, scenarios)

    def summary(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Average the trials of every signal and estimator, and of every channel, modulation and receiver.

        Returns
        -------
        DataFrame
            One row for each scene, estimator or receiver (with its parameters) and SNR: what tells the
            scenes apart, ``n_cells``, ``n_failed``. Of images ``deviation_mean`` with the half width of its
            95 % interval ``deviation_band`` (Student's t), ``n_estimated_mean``, ``precision_mean`` and
            ``recall_mean``. Of what was received ``n_bits`` and ``n_bit_errors`` of all trials, ``ber`` with
            its 95 % interval ``ber_low``, ``ber_high`` (Wilson, as if bits were independent),
            ``ber_expected``, ``evm_db`` and ``channel_error_db`` (of mean powers) and ``rate_bps``, the mean.
            Of all ``time_estimate_s_median``. Fewer than five trials have no intervals.
        """
        return statistics.summarise(rows, GROUP, _numbers)

    def tables(self, rows: pd.DataFrame) -> list[Table]:
        """Deviations of every scenario and estimator, and bit error rates of every channel and receiver."""
        summary = self.summary(rows)
        sensed, received = summary[summary["channel"] == ""], summary[summary["channel"] != ""]
        times, labels = statistics.time_notes(rows, IMAGED), kind.labels_of(sensed)
        found, first = kind.number_tables(sensed), [Column("SNR [dB]", "snr_db", "{:.4g}", part=0)]
        for key, part in sensed.groupby(IMAGED, sort=False):
            template, name, params = map(str, key)
            title = (
                f"{template}, {labels[name, params]}: mean imaging deviation by what is sensed with, "
                f"{statistics.trials_and_band(int(part['n_cells'].max()), 'interval')}{times.get(key, '')}"
            )
            headings = {signal: signal_label(signal) for signal, _ in part.groupby(SIGNAL, sort=False)}
            lines = charts.spread_rows(part.sort_values("snr_db"), ["snr_db"], SIGNAL)
            found += charts.tables_of_columns(title, first, lines, headings, deviation_text, SIGNALS_A_TABLE)
        labels, outside = receiver_labels(received), outside_interval(received)
        for key, part in received.groupby(["channel", *VARIANT], sort=False):
            channel, name, params = map(str, key)
            title = (
                f"{channel}, {labels[name, params]}: bit error rate (expected) | EVM [dB] | Gbit/s, "
                f"{counted(part['n_cells'].max(), 'frame')}"
            ) + _expectation(outside.reindex(part.index).dropna())
            headings = {(name,): name.upper() for name in part["modulation"].unique()}
            lines = charts.spread_rows(part.sort_values("snr_db"), ["snr_db"], ["modulation"])
            found += charts.tables_of_columns(title, first, lines, headings, _reception, MODULATIONS_A_TABLE)
        return found

    def charts(self, rows: pd.DataFrame, scenarios: Scenarios = NO_SCENARIOS) -> list[ChartGroup]:
        """Bit errors of every channel beside deviations of every scenario, and the trade between the two."""
        summary = self.summary(rows).sort_values("snr_db", kind="stable")
        received, sensed = summary[summary["channel"] != ""], summary[summary["channel"] == ""]
        y = Axis("bit error rate", log=True, limits=(LOWEST_BER, 1.0))
        errors = [
            Chart(f"User behind {channel}", SNR_AXIS, y, _error_series(part))
            for channel, part in received.groupby("channel", sort=False)
        ]
        labels, found = kind.labels_of(sensed), []
        for template, stem, part in kind.title_stems(sensed, "template"):
            deviation = Axis("imaging deviation", log=bool((part["deviation_mean"] > 0).any()))
            images = []
            for variant in charts.variants_in(part):
                series = _signal_series(charts.rows_of(part, variant))
                images.append(Chart(f"Image by {labels[variant]}", SNR_AXIS, deviation, series))
            title = (
                f"{template}: bit errors of the user, and deviations of the image; "
                f"{statistics.trials_and_band(int(summary['n_cells'].max()))}"
            )
            n_columns = max(len(errors), 1) if len(errors) <= 4 else 3
            found.append(ChartGroup(f"link-{stem}", title, [*errors, *images], n_columns, PANEL_IN))
            if len(received):
                found.append(_trade_charts(template, stem, part, received, labels))
        return found


def _error_series(part: pd.DataFrame) -> list[Series]:
    """Bit error rates behind a channel, and the closed form of white noise."""
    found, receivers = [], receiver_labels(part)
    for modulation in part["modulation"].unique():
        colour, own = MODULATION_COLOURS[modulation], part[part["modulation"] == modulation]
        for place, (variant, receiver) in enumerate(receivers.items()):
            rows = charts.rows_of(own[own["n_bit_errors"] > 0], variant)
            limits = charts.interval(rows, "ber")
            style = LineStyle(colour, RECEIVER_DASHES[place % len(RECEIVER_DASHES)], "circle")
            label = f"{modulation.upper()}, {receiver}"
            found.append(Series(label, rows["snr_db"], rows["ber"], *limits, style=style))
        snrs_db = np.linspace(own["snr_db"].min(), own["snr_db"].max(), 200)
        rates = awgn_ber(modulation, snrs_db)
        drawn = np.where(rates >= LOWEST_BER, rates, np.nan)
        label = f"{modulation.upper()}, closed form in white noise"
        found.append(Series(label, snrs_db, drawn, style=LineStyle(colour, "dot", "")))
    return found


def _signal_series(part: pd.DataFrame) -> list[Series]:
    """Deviations of one estimator, a line a signal."""
    found = []
    for key, rows in part.groupby(SIGNAL, sort=False):
        limits, style = charts.interval(rows, "deviation_mean", "deviation"), _signal_style(key)
        label = f"image, {signal_label(key)}"
        found.append(Series(label, rows["snr_db"], rows["deviation_mean"], *limits, style=style))
    return found


def _signal_style(signal: tuple[Any, ...]) -> LineStyle:
    sensing, modulation, division = signal
    if sensing == "prs":
        return PRS_STYLE
    return LineStyle(MODULATION_COLOURS[modulation], DIVISION_DASHES[division], "circle")


def _trade_charts(
    template: str, stem: str, sensed: pd.DataFrame, received: pd.DataFrame, labels: Mapping[Variant, str]
) -> ChartGroup:
    """Imaging deviation over the bit rate at the same SNR behind the first channel, a chart an estimator."""
    channel = received["channel"].iloc[0]
    of_channel = received[received["channel"] == channel]
    receiver = charts.variants_in(of_channel)[-1]
    rates = charts.rows_of(of_channel, receiver)[["modulation", "snr_db", "rate_bps"]]
    panels = []
    for variant in charts.variants_in(sensed):
        series = []
        for key, rows in _trade_points(charts.rows_of(sensed, variant), rates).groupby(SIGNAL, sort=False):
            sensing, modulation, division = key
            style = _signal_style(key)
            if sensing == "prs":
                style = LineStyle(MODULATION_COLOURS[modulation], "dashdot", "diamond")
            is_named = sensing != "prs" and division in ("", "reciprocal")
            texts = [f"{snr_db:g}" for snr_db in rows["snr_db"]] if is_named else []
            x, y = rows["rate_gbps"], rows["deviation_mean"]
            series.append(Series(signal_label(key), x, y, style=style, texts=texts))
        top = 1.06 * max((float(np.nanmax(np.append(one.y, 0.0))) for one in series), default=0.0) or 1.0
        axis = Axis("imaging deviation", limits=(0.0, top))
        rate = Axis("achievable bit rate [Gbit/s]")
        panels.append(Chart(f"Image by {labels[variant]}", rate, axis, series))
    title = (
        f"{template}: image against bit rate behind {channel}, {receiver_labels(received)[receiver]}; "
        "numbers are SNRs in dB"
    )
    return ChartGroup(f"trade-{stem}", title, panels, panel_in=PANEL_IN)


def _trade_points(part: pd.DataFrame, rates: pd.DataFrame) -> pd.DataFrame:
    """Deviations of one estimator and bit rates at the same SNR; those of the PRS for every modulation."""
    of_prs, part = part["sensing"] == "prs", part.drop(columns="rate_bps", errors="ignore")
    modulations = rates[["modulation"]].drop_duplicates()
    prs = part[of_prs].drop(columns="modulation").merge(modulations, how="cross")
    points = pd.concat([part[~of_prs], prs]).merge(rates, on=["modulation", "snr_db"])
    points = points[points["snr_db"].isin(TRADE_SNRS_DB)]
    path = points.groupby(SIGNAL, sort=False).ngroup()
    return points.assign(rate_gbps=points["rate_bps"] / 1e9, path=path).sort_values(["path", "snr_db"])


def signal_label(signal: tuple[Any, ...]) -> str:
    """Name sensing, modulation and division for people.

    Examples
    --------
    >>> signal_label(("all", "16qam", "matched")), signal_label(("prs", "", ""))
    ('16QAM, matched', 'PRS alone')
    """
    sensing, modulation, division = signal
    if sensing == "prs":
        return "PRS alone"
    return str(modulation).upper() + (f", {DIVISIONS[division]}" if division else "")


def receiver_labels(part: pd.DataFrame) -> dict[Variant, str]:
    """Name receivers by what they know, and by further parameters where two know the same."""
    params = {variant: json.loads(variant[1]) for variant in charts.variants_in(part)}
    known = [own["knowledge"] for own in params.values()]
    return {
        variant: KNOWLEDGE[own["knowledge"]]
        + (f", order {own['time_order']}" if known.count(own["knowledge"]) > 1 else "")
        for variant, own in params.items()
    }


def _expectation(outside: pd.Series[bool]) -> str:
    """Say whether counts of errors are as expected; empty where nothing is known to expect."""
    if outside.empty:
        return ""
    if not outside.any():
        return "; all counts of errors within the family-wise 99 % interval"
    return f"; {int(outside.sum())} of {outside.size} counts of errors outside the family-wise 99 % interval"


def _reception(entry: Mapping[Any, Any]) -> str:
    """Bit error rate beside the expected one, EVM and rate; and what failed."""
    if math.isnan(entry["ber"]):
        return charts.with_failures("", entry["n_failed"])
    rates = f"{charts.rate_text(entry['ber'])} ({charts.rate_text(entry['ber_expected'])})"
    figures = f"{rates} | {entry['evm_db']:z.1f} | {entry['rate_bps'] / 1e9:.2f}"
    return charts.with_failures(figures, entry["n_failed"])


def _numbers(part: pd.DataFrame) -> dict[str, Any]:
    """Numbers of one group: of what was received, or of what was imaged."""
    broken = failed(part)
    of_kind = _received if part["channel"].iloc[0] else _imaged
    return {"n_cells": len(part), "n_failed": int(broken.sum()), **of_kind(part[~broken])}


def outside_interval(summary: pd.DataFrame) -> pd.Series[bool]:
    """Tell which counts of bit errors lie outside the family-wise interval of what was expected.

    Of receivers that know the channel: given the fade, errors of bits are those
    of the closed form, and nearly independent. The family is all their counts.

    The interval is that of the binomial distribution with Šidák's level for
    99 % of the family. Over several fades the expected rate is a mean: counts
    then vary less than binomially, and the interval errs by being wide.
    """
    received = summary[summary["channel"] != ""]
    if received.empty:  # of a suite without channels there are no columns of bits
        return pd.Series(index=received.index, dtype=np.bool_)
    knows = received["params"].map(lambda params: json.loads(params).get("knowledge") == "perfect")
    known = received[knows & (received["n_bits"] > 0)]
    n_bits, n_errors = (known[name].to_numpy(dtype=np.int64) for name in ("n_bits", "n_bit_errors"))
    expected = known["ber_expected"].to_numpy()
    level = (1 - FAMILY_CONFIDENCE ** (1 / max(len(known), 1))) / 2
    as_few = bdtr(n_errors, n_bits, expected)
    as_many = np.where(n_errors > 0, bdtrc(n_errors - 1, n_bits, expected), 1.0)
    return pd.Series((as_few < level) | (as_many < level), index=known.index)


def _imaged(part: pd.DataFrame) -> dict[str, float]:
    """Means of the scores of images, and the band of the deviation."""
    means = {f"{name}_mean": part[name].mean() for name in ("n_estimated", "precision", "recall")}
    return statistics.deviation_columns(part) | means


def _received(part: pd.DataFrame) -> dict[str, float]:
    """Bit errors of all trials, and means of the rest."""
    n_bits, n_errors = int(part["n_bits"].sum()), int(part["n_bit_errors"].sum())
    return {
        "n_bits": n_bits,
        "n_bit_errors": n_errors,
        **statistics.share_columns("ber", n_errors, n_bits, len(part)),
        "ber_expected": part["ber_expected"].mean(),
        **{name: _mean_db(part[name]) for name in ("evm_db", "channel_error_db")},
        "rate_bps": part["rate_bps"].mean(),
    }


def _mean_db(values: pd.Series[Any]) -> float:
    """Mean of powers in dB."""
    mean = (10 ** (values / 10)).mean()
    return float(10 * np.log10(mean)) if mean > 0 else (-math.inf if mean == 0 else math.nan)
