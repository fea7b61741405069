"""The user's side of the study ``link``: channels, receivers, and frames that they meet."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import pandas as pd

from isacbench.bench.cells.cell import failed_by, failure
from isacbench.bench.cells.isolation import array_digest
from isacbench.bench.cells.record import DRAW_COLUMNS, Cell, Outcome, Record
from isacbench.bench.cells.timing import Trial, timed
from isacbench.bench.studies.study import Entry
from isacbench.bench.suites.scenario_digest import digest
from isacbench.errors import InputError, unknown_name
from isacbench.link.reception.channel import Awgn, TappedDelay, TwoRay, require_closed_form
from isacbench.link.reception.channel_estimation import require_estimable
from isacbench.link.reception.receiver import Knowledge, expected_ber, receive
from isacbench.link.waveform.figures_of_merit import frame_rates
from isacbench.link.waveform.resource_grid import draw_grid
from isacbench.model.cloud import PointCloud
from isacbench.model.echo import random_stream
from isacbench.plugins.registry import canonical_params, construct
from isacbench.plugins.specifications import parse_spec

if TYPE_CHECKING:
    from isacbench.bench.cells.record import CellStatus
    from isacbench.bench.suites.suite import LinkSuite
    from isacbench.choices import Modulation
    from isacbench.link.reception.channel import Channel
    from isacbench.link.reception.receiver import Reception
    from isacbench.link.waveform.resource_grid import ResourceGrid
    from isacbench.model.numerology import System

CHANNELS: dict[str, type[Channel]] = {kind.name: kind for kind in (Awgn, TwoRay, TappedDelay)}


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

    def meet(self, entry: Entry[OneTap]) -> Outcome:
        """Let a receiver receive the frame."""
        cell = entry.cell(self.cell)
        start = time.perf_counter()
        try:
            reception = self._receive(entry.plugin)
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            outcome = failed_by(error, cell, self.grid.bits.size, time.perf_counter() - start)
        else:
            outcome = self._outcome(cell, entry.plugin, reception, time.perf_counter() - start)
        return outcome.labelled({**self.labels, **entry.labels})

    def time_repeats(
        self, entry: Entry[OneTap], met: Outcome, n: int, before_each: Callable[[], None]
    ) -> Outcome:
        """Let a receiver receive the frame again and again."""

        def receive_again(_: None) -> Reception:
            return self._receive(entry.plugin)

        def is_same(reception: Reception) -> bool:
            return bool(reception.n_bit_errors == met.extras["n_bit_errors"])

        outcome = timed(met, entry.cell(self.cell), Trial(before_each, receive_again), n, is_same)
        return outcome.labelled({**self.labels, **entry.labels})

    def failure_row(self, entry: Entry[OneTap], status: CellStatus, reason: str, time_s: float) -> Outcome:
        """Row of a receiver that left no other trace."""
        outcome = failure(entry.cell(self.cell), status, reason, self.grid.bits.size, time_s)
        return outcome.labelled({**self.labels, **entry.labels})

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
    entries : sequence of Entry
        Receivers.
    """

    def __init__(
        self,
        suite: LinkSuite,
        system: System,
        text: str,
        channel: Channel,
        modulation: Modulation,
        entries: Sequence[Entry[OneTap]],
    ) -> None:
        self.name = f"user-{text}-{modulation}"
        self.snr_db = suite.snr_db or ()
        self.entries = entries
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


def build_channel(text: str) -> Channel:
    """Channel that ``name[param=value,...]`` describes.

    Raises
    ------
    InputError
        If name or parameters are not allowed.
    """
    name, params = parse_spec(text)
    if name not in CHANNELS:
        raise unknown_name("channel", name, CHANNELS)
    channel: Channel = construct("channel", name, CHANNELS[name], params)
    return channel


def build_receiver(text: str) -> Entry[OneTap]:
    """Receiver that ``name[param=value,...]`` describes, as an entry.

    Raises
    ------
    InputError
        If name or parameters are not allowed.
    """
    name, params = parse_spec(text)
    if name != OneTap.name:
        raise unknown_name("receiver", name, [OneTap.name])
    receiver: OneTap = construct("receiver", name, OneTap, params)
    return Entry(name, canonical_params(receiver), receiver)


def require_possible(
    suite: LinkSuite,
    system: System,
    channels: Mapping[str, Channel],
    receivers: Sequence[Entry[OneTap]],
) -> None:
    """Refuse before anything runs what would fail in every cell of a channel or a receiver.

    Of a user who moves only the first fade is looked at; a later one of more
    Doppler fails in its own cells.

    Parameters
    ----------
    suite : LinkSuite
    system : System
    channels : mapping of str to Channel
        By what the suite writes.
    receivers : sequence of Entry
        In the order of the suite.

    Raises
    ------
    InputError
        Naming the channel that the closed form does not hold for, or the
        receiver that cannot estimate the channel from the PRS.
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
