"""The study ``link``: one frame that is sensed with and that a user receives, bit errors beside images.

Two sorts of rows. Those of a scenario are ordinary ones of estimators, which
image the echo of a frame: of all its resource elements or of the PRS alone,
its data of some modulation, divided by what was sent in some way. Those of a
user are of a receiver, which has no cloud and no scores: bits, and how many
of them came out wrong.
"""

from __future__ import annotations

import dataclasses
import json
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import pandas as pd
from scipy.special import bdtr, bdtrc

from isacbench.bench.cell import failed_by, failure
from isacbench.bench.content import digest
from isacbench.bench.imaging import require_scatterers
from isacbench.bench.intervals import mean_band, wilson_interval
from isacbench.bench.isolation import array_digest
from isacbench.bench.radio import gain_db
from isacbench.bench.record import DRAW_COLUMNS, Cell, Outcome, Record
from isacbench.bench.statuses import failed
from isacbench.bench.study import Contestant, ImagedScene, build_estimators, element_snrs_db
from isacbench.bench.timing import Trial, timed
from isacbench.errors import InputError, unknown_name
from isacbench.link.channel import Awgn, TappedDelay, TwoRay, require_closed_form
from isacbench.link.estimation import require_estimable
from isacbench.link.grid import draw_grid
from isacbench.link.observing import SignalSimulator
from isacbench.link.rates import frame_rates
from isacbench.link.receiver import Knowledge, expected_ber, receive
from isacbench.link.signal import Signal
from isacbench.model.cloud import PointCloud
from isacbench.model.echo import random_stream
from isacbench.registry import canonical_params, construct
from isacbench.spec import parse_spec

if TYPE_CHECKING:
    from isacbench.bench.record import Status
    from isacbench.bench.study import Scene
    from isacbench.bench.suite import LinkSuite
    from isacbench.link.channel import Channel
    from isacbench.link.grid import ResourceGrid
    from isacbench.link.qam import Modulation
    from isacbench.link.receiver import Reception
    from isacbench.model.numerology import System
    from isacbench.model.scenario import Scenario

__all__ = ["Link", "OneTap", "UserScene", "outside_interval", "signals_of", "summarise"]

CHANNELS: dict[str, type[Channel]] = {kind.name: kind for kind in (Awgn, TwoRay, TappedDelay)}


def signals_of(suite: LinkSuite) -> dict[str, Signal]:
    """Signals that the scenarios of a suite are sensed with, by a short name, each once.

    Where all symbols that are sensed with have the same power, all divisions
    are the same; and of the PRS, which is QPSK always, all modulations.

    Parameters
    ----------
    suite : LinkSuite

    Returns
    -------
    dict of str to Signal
        Such as ``all-qpsk``, ``all-16qam-matched`` and ``prs``.
    """
    signals: dict[str, Signal] = {}
    for sensing in suite.sensing:
        for modulation in suite.modulations:
            for division in suite.divisions:
                signal = Signal(modulation, sensing, division)
                if sensing == "prs":
                    name = "prs"
                elif signal.has_unit_modulus:
                    name = f"{sensing}-{modulation}"
                else:
                    name = f"{sensing}-{modulation}-{division}"
                signals.setdefault(name, signal)
    return signals


class Link:
    """Imaging deviation of what is sensed, and bit error rate of what is received, over SNR."""

    columns: ClassVar[Mapping[str, Any]] = {
        "snr_gain_db": math.nan,
        "template": "",
        "modulation": "",
        "sensing": "",
        "division": "",
        "channel": "",
        "n_bits": 0,
        "n_bit_errors": 0,
        "ber_expected": math.nan,
        "evm_db": math.nan,
        "channel_error_db": math.nan,
        "rate_bps": math.nan,
    }

    def scenes(self, suite: LinkSuite, scenarios: Mapping[str, Scenario]) -> list[Scene]:
        """Every scenario with every signal, and every channel with every modulation."""
        if suite.snr_db is None:
            raise InputError(
                "snr_gain_db: a suite of the kind link takes snr_db, because a user has no array to gain by"
            )
        contestants = build_estimators(suite)
        require_scatterers(scenarios)
        scenes: list[Scene] = [
            _sensed_scene(suite, scenario, name, signal, contestants)
            for scenario in scenarios.values()
            for name, signal in signals_of(suite).items()
        ]
        system = _common_system(scenarios)
        receivers = [_receiver(text) for text in suite.receivers]
        channels = {text: _channel(text) for text in suite.channels}
        if channels:
            _require_possible(suite, system, channels, receivers)
        return scenes + [
            UserScene(suite, system, text, channel, modulation, receivers)
            for text, channel in channels.items()
            for modulation in suite.modulations
        ]


@dataclass(frozen=True)
class OneTap:
    """Receiver of the user: one division a resource element, decisions symbol by symbol.

    Attributes
    ----------
    knowledge : {"prs", "perfect"}
        Where its knowledge of the channel comes from.
    time_order : int
        Order of the polynomial that the estimated channel follows in time.
    """

    name: ClassVar[str] = "one_tap"

    knowledge: Knowledge = "prs"
    time_order: int = 0


@dataclass(frozen=True, eq=False)
class Arrival:
    """A frame on its way to the user, which receivers meet.

    Attributes
    ----------
    cell : Cell
        Key of its rows, without a receiver.
    grid : ResourceGrid
    system : System
    channel : Channel
    labels : mapping of str to Any
        Further columns of every row.
    """

    cell: Cell
    grid: ResourceGrid
    system: System
    channel: Channel
    labels: Mapping[str, Any]

    def meet(self, contestant: Contestant[OneTap]) -> Outcome:
        """Let a receiver receive the frame."""
        cell = contestant.cell(self.cell)
        start = time.perf_counter()
        try:
            reception = self._receive(contestant.plugin)
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            outcome = failed_by(error, cell, self.grid.bits.size, time.perf_counter() - start)
        else:
            outcome = self._outcome(cell, contestant.plugin, reception, time.perf_counter() - start)
        return outcome.labelled({**self.labels, **contestant.labels})

    def time_repeats(
        self, contestant: Contestant[OneTap], met: Outcome, n: int, before_each: Callable[[], None]
    ) -> Outcome:
        """Let a receiver receive the frame again and again."""

        def receive_again(_: None) -> Reception:
            return self._receive(contestant.plugin)

        def is_same(reception: Reception) -> bool:
            return bool(reception.n_bit_errors == met.extras["n_bit_errors"])

        outcome = timed(met, contestant.cell(self.cell), Trial(before_each, receive_again), n, is_same)
        return outcome.labelled({**self.labels, **contestant.labels})

    def forfeit(self, contestant: Contestant[OneTap], status: Status, reason: str, time_s: float) -> Outcome:
        """Row of a receiver that left no other trace."""
        outcome = failure(contestant.cell(self.cell), status, reason, self.grid.bits.size, time_s)
        return outcome.labelled({**self.labels, **contestant.labels})

    def digest(self) -> str:
        """Digest of the frame."""
        return digest([array_digest(self.grid.symbols), array_digest(self.grid.bits)])

    def _receive(self, receiver: OneTap) -> Reception:
        return receive(self.grid, self.system, self.channel, self.cell.snr_db, **self._given(receiver))

    def _given(self, receiver: OneTap) -> dict[str, Any]:
        """What reception follows from beside frame, channel and SNR."""
        return {**dataclasses.asdict(receiver), "trial": self.cell.trial, "seed": self.cell.seed}

    def _outcome(self, cell: Cell, receiver: OneTap, reception: Reception, time_s: float) -> Outcome:
        """Row of a reception: of all bits those that came out right."""
        modulation, rates = self.grid.modulation, frame_rates(self.system, self.grid.modulation)
        ber_expected = expected_ber(
            modulation, self.system, self.channel, cell.snr_db, **self._given(receiver)
        )
        record = Record(
            **vars(cell),
            status="ok",
            reason="",
            n_true=reception.n_bits,
            n_estimated=reception.n_bits - reception.n_bit_errors,
            time_estimate_s=time_s,
        )
        extras = {
            "n_bits": reception.n_bits,
            "n_bit_errors": reception.n_bit_errors,
            "ber_expected": ber_expected,
            "rate_bps": float(rates.achievable_rate_bps(min(reception.ber, 0.5))),
            "evm_db": reception.evm_db,
            "channel_error_db": reception.channel_error_db,
        }
        return Outcome(record, PointCloud.empty(), extras)


class UserScene:
    """A channel, a modulation, and the receivers behind them.

    Parameters
    ----------
    suite : LinkSuite
    system : System
    text : str
        Channel as the suite writes it.
    channel : Channel
    modulation : {"qpsk", "16qam", "64qam", "256qam"}
    contestants : sequence of Contestant
        Receivers.
    """

    def __init__(
        self,
        suite: LinkSuite,
        system: System,
        text: str,
        channel: Channel,
        modulation: Modulation,
        contestants: Sequence[Contestant[OneTap]],
    ) -> None:
        self.name = f"user-{text}-{modulation}"
        self.snr_db = suite.snr_db or ()
        self.contestants = contestants
        self._suite, self._system = suite, system
        self._channel, self._modulation = channel, modulation
        self._labels = {"channel": text, "modulation": modulation}
        self._sent: tuple[int, ResourceGrid] | None = None

    @cached_property
    def content(self) -> str:
        """Digest of radio, channel and modulation, from which all rows follow."""
        system = dataclasses.asdict(self._system)
        return digest([self._suite.kind, system, canonical_params(self._channel), self._labels])

    def observe(self, snr_db: float, trial: int) -> Arrival:
        """Send a frame, for all receivers."""
        suite = self._suite
        cell = Cell(suite.name, self.name, "", "", snr_db, trial, suite.seed, self.content)
        return Arrival(cell, self._grid(trial), self._system, self._channel, self._labels)

    def forget(self) -> None:
        """Let go of the frame."""
        self._sent = None

    def draws(self, n_trials: int) -> pd.DataFrame:
        """Give no scatterers: a user has none."""
        return pd.DataFrame(columns=DRAW_COLUMNS)

    def _grid(self, trial: int) -> ResourceGrid:
        if self._sent is None or self._sent[0] != trial:
            self._sent = trial, draw_grid(self._system, self._modulation, trial=trial, seed=self._suite.seed)
        return self._sent[1]


def _sensed_scene(
    suite: LinkSuite,
    scenario: Scenario,
    name: str,
    signal: Signal,
    contestants: Sequence[Contestant[Any]],
) -> ImagedScene:
    """A scenario that is sensed with a signal; of the PRS alone the data's modulation does not matter."""
    labels = {
        "template": scenario.name,
        "modulation": "" if signal.sensing == "prs" else signal.modulation,
        "sensing": signal.sensing,
        "division": "" if signal.has_unit_modulus else signal.division,
    }
    return ImagedScene(
        suite,
        scenario,
        contestants,
        element_snrs_db(suite, gain_db(scenario)),
        name=f"{scenario.name}-{name}",
        simulator=partial(SignalSimulator, signal=signal),
        labels=labels,
    )


def _channel(text: str) -> Channel:
    """Channel that ``name[param=value,...]`` describes."""
    name, params = parse_spec(text)
    if name not in CHANNELS:
        raise unknown_name("channel", name, CHANNELS)
    channel: Channel = construct("channel", name, CHANNELS[name], params)
    return channel


def _receiver(text: str) -> Contestant[OneTap]:
    """Receiver that ``name[param=value,...]`` describes."""
    name, params = parse_spec(text)
    if name != OneTap.name:
        raise unknown_name("receiver", name, [OneTap.name])
    receiver: OneTap = construct("receiver", name, OneTap, params)
    return Contestant(name, canonical_params(receiver), receiver)


def _require_possible(
    suite: LinkSuite,
    system: System,
    channels: Mapping[str, Channel],
    receivers: Sequence[Contestant[OneTap]],
) -> None:
    """Refuse before anything runs what would fail in every cell of a channel or a receiver.

    Of a user who moves only the first fade is looked at; a later one of more
    Doppler fails in its own cells.
    """
    for text, channel in channels.items():
        stream = random_stream("channel", 0, suite.seed, channel.name)
        with _named(f"channels: {text!r}"):
            require_closed_form(system, channel.paths(system, stream))
    for text, receiver in zip(suite.receivers, receivers, strict=True):
        if receiver.plugin.knowledge == "prs":
            with _named(f"receivers: {text!r}"):
                require_estimable(system, receiver.plugin.time_order)


@contextmanager
def _named(what: str) -> Iterator[None]:
    """Put before a refusal what is refused."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{what}: {error}") from error


def _common_system(scenarios: Mapping[str, Scenario]) -> System:
    """Radio of the scenarios, whose frame the user receives.

    Raises
    ------
    InputError
        If they have not all the same.
    """
    (first, scenario), *others = scenarios.items()
    for name, other in others:
        if other.system != scenario.system:
            raise InputError(
                f"scenarios: {first!r} and {name!r} have different systems; a suite of the kind link takes "
                "scenarios of one system, whose frame the user receives"
            )
    return scenario.system


FAMILY_CONFIDENCE = 0.99
"""Of the interval that all counts of bit errors of a run are held against together."""

GROUP = [
    "scenario",
    "template",
    "modulation",
    "sensing",
    "division",
    "channel",
    "estimator",
    "params",
    "snr_db",
]


def summarise(records: pd.DataFrame) -> pd.DataFrame:
    """Average the trials of every signal and estimator, and of every channel, modulation and receiver.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.

    Returns
    -------
    DataFrame
        One row for each scene, estimator or receiver (with its parameters)
        and SNR: what tells the scenes apart, ``n_cells``, ``n_failed``. Of
        images ``deviation_mean`` with the half width of its 95 % interval
        ``deviation_band`` (Student's t), ``n_estimated_mean``,
        ``precision_mean`` and ``recall_mean``. Of what was received
        ``n_bits`` and ``n_bit_errors`` of all trials, ``ber`` with its 95 %
        interval ``ber_low``, ``ber_high`` (Wilson, as if bits were
        independent), ``ber_expected``, ``evm_db`` and ``channel_error_db``
        (of mean powers) and ``rate_bps``, the mean. ``time_estimate_s_median``
        of all.
    """
    rows = []
    for key, part in records.groupby(GROUP, sort=False):
        broken = failed(part)
        fine = part[~broken]
        row: dict[str, Any] = {
            **dict(zip(GROUP, key, strict=True)),
            "n_cells": len(part),
            "n_failed": int(broken.sum()),
        }
        row |= _received(fine) if row["channel"] else _imaged(fine)
        rows.append(row | {"time_estimate_s_median": fine["time_estimate_s"].median()})
    return pd.DataFrame(rows)


def outside_interval(summary: pd.DataFrame) -> pd.Series[bool]:
    """Tell which counts of bit errors lie outside the family-wise interval of what was expected.

    Of receivers that know the channel: given the fade, errors of bits are those
    of the closed form, and nearly independent. The family is all their counts.

    Parameters
    ----------
    summary : DataFrame
        As `summarise` returns it.

    Returns
    -------
    Series of bool
        Of the index of the receivers' rows that know the channel.

    Notes
    -----
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
    mean, half = mean_band(part["deviation"].dropna().to_numpy())
    return {
        "deviation_mean": mean,
        "deviation_band": half,
        **{f"{name}_mean": part[name].mean() for name in ("n_estimated", "precision", "recall")},
    }


def _received(part: pd.DataFrame) -> dict[str, float]:
    """Bit errors of all trials, and means of the rest."""
    n_bits, n_errors = int(part["n_bits"].sum()), int(part["n_bit_errors"].sum())
    low, high = wilson_interval(n_errors, n_bits)
    return {
        "n_bits": n_bits,
        "n_bit_errors": n_errors,
        "ber": n_errors / n_bits if n_bits else math.nan,
        "ber_low": low,
        "ber_high": high,
        "ber_expected": part["ber_expected"].mean(),
        **{name: _mean_db(part[name]) for name in ("evm_db", "channel_error_db")},
        "rate_bps": part["rate_bps"].mean(),
    }


def _mean_db(values: pd.Series[Any]) -> float:
    """Mean of powers in dB."""
    mean = (10 ** (values / 10)).mean()
    return float(10 * np.log10(mean)) if mean > 0 else (-math.inf if mean == 0 else math.nan)
