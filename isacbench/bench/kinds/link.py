"""The kind ``link``: one frame that is sensed with and that a user receives, bit errors beside images.

Two sorts of rows. Those of a scenario are ordinary ones of estimators, which
image the echo of a frame: of all its resource elements or of the PRS alone,
its data of some modulation, divided by what was sent in some way. Those of a
user are of a receiver, which has no cloud and no scores: bits, and how many
of them came out wrong.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from typing import Any, ClassVar, get_args

import numpy as np
import pandas as pd

from isacbench import charts
from isacbench.bench import statistics
from isacbench.bench.cells.images import Found
from isacbench.bench.cells.rows import failed, status_of
from isacbench.bench.cells.task import ImagingTask, Shared, Task, build_estimators, distinct_entries, entry_of
from isacbench.bench.kinds import kind
from isacbench.bench.kinds.imaging import deviation_text
from isacbench.bench.kinds.kind import NO_SCENARIOS, SNR_GAIN, Kind, Scenarios
from isacbench.bench.suites.scenario_digest import described_fields, digest
from isacbench.bench.suites.suite import Distinct, Listed, Suite
from isacbench.charts import VARIANT, Axis, Chart, ChartGroup, Column, Line, LineStyle, Series, Table, Variant
from isacbench.choices import Division, Modulation, Sensing
from isacbench.errors import InputError, unknown_name
from isacbench.files.escaping import plural
from isacbench.link.reception.channel import Awgn, Channel, TappedDelay, TwoRay, require_closed_form
from isacbench.link.reception.channel_estimation import require_estimable
from isacbench.link.reception.receiver import Knowledge, Reception, expected_ber, receive
from isacbench.link.sensing.division import Signal
from isacbench.link.sensing.link_observation import SignalSimulator
from isacbench.link.waveform.qam import awgn_ber
from isacbench.link.waveform.resource_grid import draw_grid, frame_rates
from isacbench.model.cloud import PointCloud
from isacbench.model.echo import random_stream
from isacbench.model.numerology import System
from isacbench.plugins.registry import canonical_params, construct
from isacbench.specifications import parse_spec

SIGNAL = ["sensing", "modulation", "division"]
GROUP = ["scenario", "template", "modulation", "sensing", "division", "channel", *VARIANT, "snr_db"]

LOWEST_BER = 1e-6
"""A frame has a few million bits: fewer errors are not seen."""

TRADE_SNRS_DB = 0.0, 10.0, 20.0, 30.0
SNR_AXIS = Axis("SNR of a resource element [dB]")
DEVIATION = Axis("imaging deviation", log=True)
PANEL_IN = 3.1, 2.5


class LinkSuite(Suite):
    """Suite of the kind ``link``.

    Attributes
    ----------
    modulations : tuple of {"qpsk", "16qam", "64qam", "256qam"}
        Modulations of the data that are sent, received, and sensed with.
    sensing : tuple of {"all", "prs"}
        Resource elements that are sensed with.
    divisions : tuple of {"reciprocal", "matched", "wiener"}
        Divisions of the echo by symbols of unequal power.
    channels : tuple of str
        Channels to the user as ``name[param=value,...]``: ``awgn``,
        ``two_ray`` and ``tapped_delay``, see `isacbench.link.reception.channel`.
    receivers : tuple of str
        Receivers of the user, likewise: ``one_tap``, see `OneTap`.
    """

    kind: str = "link"
    modulations: Listed[Modulation] = get_args(Modulation)
    sensing: Listed[Sensing] = get_args(Sensing)
    divisions: Listed[Division] = get_args(Division)
    channels: Distinct[str] = ("awgn", "two_ray", "tapped_delay")
    receivers: Listed[str] = ("one_tap[knowledge=perfect]", "one_tap")


@dataclass(frozen=True)
class OneTap:
    """Receiver of the user: one division a resource element, decisions symbol by symbol.

    Attributes
    ----------
    knowledge : {"prs", "perfect"}
        Source of its knowledge of the channel.
    time_order : int
        Order of the polynomial that the estimated channel follows in time.
    """

    name: ClassVar[str] = "one_tap"

    knowledge: Knowledge = "prs"
    time_order: int = 0


CHANNELS: dict[str, type[Channel]] = {kind.name: kind for kind in (Awgn, TwoRay, TappedDelay)}
RECEIVERS = {OneTap.name: OneTap}


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

    def tasks(self, suite: LinkSuite, scenarios: Scenarios) -> list[Task]:
        """Plan every scenario with every signal, and every channel with every modulation.

        What would fail in every cell is refused.
        """
        if suite.snr_db is None:
            raise InputError(
                "snr_gain_db: a suite of the kind link takes snr_db, because a user has no array gain"
            )
        entries, systems = build_estimators(suite), {}
        for scenario in scenarios.values():
            scenario.require_default("a suite of the kind link", "noise", "mimo")
            systems[scenario.name] = scenario.system
        (first, system), *others = systems.items()
        if unlike := [name for name, other in others if other != system]:
            raise InputError(
                f"scenarios: {first!r} and {unlike[0]!r} have different systems; a suite of the kind link "
                "takes scenarios of one system, whose frame the user receives"
            )
        tasks = []
        for scenario, (name, signal) in product(scenarios.values(), signals_of(suite).items()):
            labels = {
                "template": scenario.name,
                "modulation": "" if signal.sensing == "prs" else signal.modulation,
                "sensing": signal.sensing,
                "division": "" if signal.has_unit_modulus else signal.division,
            }
            own_name, simulator = f"{scenario.name}-{name}", partial(SignalSimulator, signal=signal)
            task = ImagingTask(suite, scenario, entries, name=own_name, simulator=simulator, labels=labels)
            tasks.append(task)
        return [*tasks, *_reception_tasks(suite, system)]

    def summary(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Average the trials of every signal and estimator, and of every channel, modulation and receiver.

        One row for each scene, estimator or receiver and SNR: what tells the scenes apart, ``n_cells``,
        ``n_failed``. Of images ``deviation_mean`` with the half width of its 95 % interval ``deviation_band``
        (Student's t), ``n_estimated_mean``, ``precision_mean`` and ``recall_mean``. Of what was received
        ``n_bits`` and ``n_bit_errors`` of all trials, ``ber`` with its 95 % interval ``ber_low``,
        ``ber_high`` (Wilson, as if bits were independent), ``ber_expected``, ``evm_db`` and
        ``channel_error_db`` (of mean powers) and ``rate_bps``, the mean. Of all ``time_estimate_s_median``.
        Fewer than five trials have no intervals.
        """
        return statistics.summarise(rows, GROUP, _numbers)

    def tables(self, rows: pd.DataFrame) -> list[Table]:
        """Deviations of every scenario and estimator, and bit error rates of every channel and receiver."""
        summary = self.summary(rows).sort_values("snr_db", kind="stable")
        sensed, received = map(kind.with_labels, _sensed_and_received(summary))
        tables, first = kind.number_tables(sensed), [Column("SNR [dB]", "snr_db", "{:.4g}", part=0)]
        for (template, label), part in sensed.groupby(["template", "label"], sort=False):
            trials = statistics.trials_and_band(part["n_cells"].max())
            title = f"{template}, {label}: mean imaging deviation by what is sensed with, {trials}"
            headings = {signal: signal_label(signal) for signal, _ in part.groupby(SIGNAL, sort=False)}
            lines = charts.spread_rows(part, ["snr_db"], SIGNAL)
            tables.append(Table(title, [*first, *charts.spread_columns(headings, deviation_text)], lines))
        for (channel, label), part in received.groupby(["channel", "label"], sort=False):
            frames = plural(part["n_cells"].max(), "frame")
            title = f"{channel}, {label}: bit error rate (expected) | EVM [dB] | Gbit/s, {frames}"
            headings = {(name,): name.upper() for name in part["modulation"].unique()}
            lines = charts.spread_rows(part, ["snr_db"], ["modulation"])
            tables.append(Table(title, [*first, *charts.spread_columns(headings, _reception_text)], lines))
        return tables

    def charts(self, rows: pd.DataFrame, scenarios: Scenarios = NO_SCENARIOS) -> list[ChartGroup]:
        """Bit errors of every channel beside deviations of every scenario, and the trade between the two."""
        summary = self.summary(rows).sort_values("snr_db", kind="stable")
        sensed, received = _sensed_and_received(summary)
        y = Axis("bit error rate", log=True, limits=(LOWEST_BER, 1.0))
        errors = [
            Chart(f"User behind {channel}", SNR_AXIS, y, _error_series(part))
            for channel, part in received.groupby("channel", sort=False)
        ]
        labels, groups = kind.labels_of(sensed), []
        for template, stem, part in kind.title_stems(sensed, "template"):
            images = []
            for variant in charts.variants_in(part):
                own, lines = _with_lines(charts.rows_of(part, variant), SIGNAL)
                series = charts.line_series(own, lines, "snr_db", "deviation_mean", "deviation")
                images.append(Chart(f"Image by {labels[variant]}", SNR_AXIS, DEVIATION, series))
            title = (
                f"{template}: bit errors of the user, and deviations of the image; "
                f"{statistics.trials_and_band(summary['n_cells'].max())}"
            )
            groups.append(ChartGroup(f"link-{stem}", title, [*errors, *images], len(errors) or 1, PANEL_IN))
            if len(received):
                groups.append(_trade_charts(template, stem, part, received, labels))
        return groups


def _sensed_and_received(summary: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    is_sensed = summary["channel"] == ""
    return summary[is_sensed], summary[~is_sensed]


def _with_lines(part: pd.DataFrame, names: list[str]) -> tuple[pd.DataFrame, dict[Variant, Line]]:
    """Label rows by some columns, and give each label a line; modulations have their colours."""
    labels = [signal_label(values) for values in part[names].itertuples(index=False)]
    part = part.assign(estimator=part["modulation"], params=labels)
    return part, charts.assign_lines({variant: variant[1] for variant in charts.variants_in(part)})


def _error_series(part: pd.DataFrame) -> list[Series]:
    """Bit error rates behind a channel where there are errors, and the closed form of white noise."""
    part = kind.with_labels(part.assign(ber=part["ber"].where(part["n_bit_errors"] > 0)))
    part, lines = _with_lines(part, ["modulation", "label"])
    series = charts.line_series(part, lines, "snr_db", "ber", "ber")
    first: dict[Any, Line] = {modulation: line for (modulation, _), line in reversed(lines.items())}
    for modulation, line in first.items():
        snrs_db = np.linspace(part["snr_db"].min(), part["snr_db"].max(), 200)
        rates = awgn_ber(modulation, snrs_db)
        rates[rates < LOWEST_BER] = np.nan
        label = f"{modulation} closed form in white noise"
        series.append(Series(label, snrs_db, rates, style=LineStyle(line.style.colour, "dot", "")))
    return series


def _trade_charts(
    template: str, stem: str, sensed: pd.DataFrame, received: pd.DataFrame, labels: Mapping[Variant, str]
) -> ChartGroup:
    """Imaging deviation over the bit rate at the same SNR behind the first channel, a chart an estimator."""
    channel = received["channel"].iloc[0]
    receiver, label = list(kind.labels_of(received).items())[-1]
    rates = charts.rows_of(received[received["channel"] == channel], receiver)
    rates = rates[["modulation", "snr_db"]].assign(rate_gbps=rates["rate_bps"] / 1e9)
    sensed = sensed[sensed["snr_db"].isin(TRADE_SNRS_DB)]
    of_prs = sensed["sensing"] == "prs"  # whose image is the same whatever the modulation of the data
    prs = sensed[of_prs].drop(columns="modulation").merge(rates, on="snr_db")
    points = pd.concat([sensed[~of_prs].merge(rates, on=["modulation", "snr_db"]), prs])
    x, panels = Axis("achievable bit rate [Gbit/s]"), []
    for variant in charts.variants_in(sensed):
        own, lines = _with_lines(charts.rows_of(points, variant), SIGNAL)
        series = charts.line_series(own, lines, "rate_gbps", "deviation_mean")
        panels.append(Chart(f"Image by {labels[variant]}", x, DEVIATION, series))
    title = f"{template}: image against bit rate behind {channel}, {label}; at 0, 10, 20 and 30 dB"
    return ChartGroup(f"trade-{stem}", title, panels, panel_in=PANEL_IN)


def signal_label(signal: tuple[Any, ...]) -> str:
    """Name what is sensed with: sensing, and modulation and division where they matter."""
    return " ".join(filter(None, signal))


def _reception_text(entry: Mapping[Any, Any]) -> str:
    """Bit error rate beside the expected one, EVM and rate; and what failed."""
    if math.isnan(entry["ber"]):
        return charts.with_failures("", entry["n_failed"])
    rates = f"{charts.rate_text(entry['ber'])} ({charts.rate_text(entry['ber_expected'])})"
    figures = f"{rates} | {entry['evm_db']:z.1f} | {entry['rate_bps'] / 1e9:.2f}"
    return charts.with_failures(figures, entry["n_failed"])


def _numbers(part: pd.DataFrame) -> dict[str, Any]:
    """Numbers of one group: of what was received, or of what was imaged."""
    broken = failed(part)
    counts, scored = {"n_cells": len(part), "n_failed": int(broken.sum())}, part[~broken]
    if part["channel"].iloc[0]:
        return counts | _received(scored)
    means = {f"{name}_mean": scored[name].mean() for name in ("n_estimated", "precision", "recall")}
    return {**counts, **statistics.deviation_columns(scored), **means}


def _received(part: pd.DataFrame) -> dict[str, float]:
    """Bit errors of all trials, and means of the rest, of dB those of powers."""
    n_bits, n_errors = int(part["n_bits"].sum()), int(part["n_bit_errors"].sum())
    with np.errstate(divide="ignore"):
        power_db = 10 * np.log10((10 ** (part[["evm_db", "channel_error_db"]] / 10)).mean())
    return {
        "n_bits": n_bits,
        "n_bit_errors": n_errors,
        **statistics.share_columns("ber", n_errors, n_bits, len(part)),
        "ber_expected": part["ber_expected"].mean(),
        **power_db.to_dict(),
        "rate_bps": part["rate_bps"].mean(),
    }


class ReceptionTask(Task):
    """A channel with a modulation, the `labels` of its rows, and the receivers behind it."""

    def __init__(
        self, suite: LinkSuite, system: System, channel: Channel, labels: dict[str, Any], entries: list[Any]
    ) -> None:
        self._system, self._channel, self._labels = system, channel, labels
        draw = partial(draw_grid, system, labels["modulation"], seed=suite.seed)
        name = f"user-{labels['channel']}-{labels['modulation']}"
        super().__init__(suite, name, entries, suite.snr_db or (), lambda trial: draw(trial=trial))

    @cached_property
    def content(self) -> str:
        """Digest of radio, channel and modulation, from which all rows follow."""
        system = described_fields(self._system)
        return digest([self._suite.kind, system, canonical_params(self._channel), self._labels])

    def observe(self, snr_db: float, trial: int) -> Shared:
        """Send a frame, for all receivers."""
        grid = self._draw_once(trial)
        return Shared(self._key(snr_db, trial), self._labels, grid.bits.size, grid)

    def call(self, shared: Shared, plugin: OneTap) -> Reception:
        """Receive the frame."""
        given = _conditions(shared, plugin)
        return receive(shared.data, self._system, self._channel, shared.key["snr_db"], **given)

    def score(self, shared: Shared, plugin: OneTap, answer: Reception) -> Found:
        """Count bits that came out right and wrong, and derive rates and errors."""
        modulation, n_right = shared.data.modulation, answer.n_bits - answer.n_bit_errors
        rates, given = frame_rates(self._system, modulation), _conditions(shared, plugin)
        expected = expected_ber(modulation, self._system, self._channel, shared.key["snr_db"], **given)
        return {
            "status": status_of(n_right),
            "n_estimated": n_right,
            "n_bits": answer.n_bits,
            "n_bit_errors": answer.n_bit_errors,
            "ber_expected": expected,
            "rate_bps": float(rates.achievable_rate_bps(min(answer.ber, 0.5))),
            "evm_db": answer.evm_db,
            "channel_error_db": answer.channel_error_db,
        }, PointCloud.empty()


def _conditions(shared: Shared, receiver: OneTap) -> dict[str, Any]:
    """Conditions of a reception besides frame, channel and SNR."""
    return {**dataclasses.asdict(receiver), "trial": shared.key["trial"], "seed": shared.key["seed"]}


def signals_of(suite: LinkSuite) -> dict[str, Signal]:
    """Signals that the scenarios of a suite are sensed with, each once, by names as ``all-16qam-matched``.

    Where all symbols that are sensed with have the same power, all divisions
    are the same; and of the PRS, which is QPSK always, all modulations.
    """
    signals: dict[str, Signal] = {}
    for sensing, modulation, division in product(suite.sensing, suite.modulations, suite.divisions):
        signal = Signal(modulation, sensing, division)
        name = "prs" if sensing == "prs" else f"{sensing}-{modulation}"
        if not signal.has_unit_modulus:
            name += f"-{division}"
        signals.setdefault(name, signal)
    return signals


def _reception_tasks(suite: LinkSuite, system: System) -> list[ReceptionTask]:
    """Every channel with every modulation, all receivers behind them.

    Refused are unknown channels and receivers, a channel that the closed form does not hold for, and a
    receiver that cannot estimate the channel from the PRS. Of a channel that moves only the first fade is
    looked at; a later one with more Doppler fails in its own cells.
    """
    channels: dict[str, Channel] = {text: _construct("channel", text, CHANNELS) for text in suite.channels}
    receivers: dict[str, OneTap] = {text: _construct("receiver", text, RECEIVERS) for text in suite.receivers}
    written = ((text, entry_of(receiver)) for text, receiver in receivers.items())
    entries = distinct_entries("receiver", written)
    try:
        for text, channel in channels.items():
            what = f"channels: {text!r}"
            stream = random_stream("channel", 0, suite.seed, channel.name)
            require_closed_form(system, channel.paths(system, stream))
        for text, receiver in receivers.items():
            what = f"receivers: {text!r}"
            if channels and receiver.knowledge == "prs":
                require_estimable(system, receiver.time_order)
    except InputError as error:
        raise InputError(f"{what}: {error}") from error
    return [
        ReceptionTask(suite, system, channel, {"channel": text, "modulation": modulation}, entries)
        for (text, channel), modulation in product(channels.items(), suite.modulations)
    ]


def _construct(what: str, text: str, classes: Mapping[str, type[Any]]) -> Any:
    """Channel or receiver that ``name[param=value,...]`` describes."""
    name, params = parse_spec(text)
    if name not in classes:
        raise unknown_name(what, name, classes)
    return construct(what, name, classes[name], params)
