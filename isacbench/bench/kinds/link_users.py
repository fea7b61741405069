"""The user's side of the kind ``link``: channels, receivers, and frames that they receive."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

from isacbench.bench.cells.cell import Found, array_digest
from isacbench.bench.cells.record import Row, status_of
from isacbench.bench.kinds.scenes import Entry, Scene, SharedObservation, distinct_entries, entry_of
from isacbench.bench.suites.scenario_digest import described_fields, digest
from isacbench.bench.suites.suite import Suite
from isacbench.choices import Modulation
from isacbench.errors import InputError, unknown_name
from isacbench.link.reception.channel import Awgn, Channel, TappedDelay, TwoRay, require_closed_form
from isacbench.link.reception.channel_estimation import require_estimable
from isacbench.link.reception.receiver import Knowledge, Reception, expected_ber, receive
from isacbench.link.waveform.figures_of_merit import frame_rates
from isacbench.link.waveform.resource_grid import ResourceGrid, draw_grid
from isacbench.model.cloud import PointCloud
from isacbench.model.echo import random_stream
from isacbench.model.numerology import System
from isacbench.plugins.registry import canonical_params, construct
from isacbench.specifications import parse_spec


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


@dataclass(frozen=True, eq=False)
class Arrival(SharedObservation):
    """Frame on its way to the user, which receivers receive."""

    grid: ResourceGrid
    system: System
    channel: Channel

    def digest(self) -> str:
        """Digest of the frame."""
        return digest([array_digest(self.grid.symbols), array_digest(self.grid.bits)])

    def call(self, plugin: OneTap) -> Reception:
        """Receive the frame."""
        return receive(self.grid, self.system, self.channel, self.key["snr_db"], **self._given(plugin))

    def score(self, plugin: OneTap, answer: Reception) -> Found:
        """Count bits that came out right and wrong, and derive rates and errors."""
        modulation, n_right = self.grid.modulation, answer.n_bits - answer.n_bit_errors
        rates = frame_rates(self.system, modulation)
        ber_expected = expected_ber(
            modulation, self.system, self.channel, self.key["snr_db"], **self._given(plugin)
        )
        return {
            "status": status_of(n_right),
            "n_estimated": n_right,
            "n_bits": answer.n_bits,
            "n_bit_errors": answer.n_bit_errors,
            "ber_expected": ber_expected,
            "rate_bps": float(rates.achievable_rate_bps(min(answer.ber, 0.5))),
            "evm_db": answer.evm_db,
            "channel_error_db": answer.channel_error_db,
        }, PointCloud.empty()

    def n_differing(self, answers: Sequence[Reception], row: Row) -> int:
        """Count the receptions with other bit errors than a row."""
        return sum(answer.n_bit_errors != row.found["n_bit_errors"] for answer in answers)

    def _given(self, receiver: OneTap) -> dict[str, Any]:
        """Conditions of a reception besides frame, channel and SNR."""
        return {**dataclasses.asdict(receiver), "trial": self.key["trial"], "seed": self.key["seed"]}


class UserScene(Scene):
    """Channel (`text` as the suite writes it), modulation, and the receivers behind them."""

    def __init__(
        self,
        suite: Suite,
        system: System,
        text: str,
        channel: Channel,
        modulation: Modulation,
        entries: Sequence[Entry[OneTap]],
    ) -> None:
        self._system, self._channel = system, channel
        self._labels = {"channel": text, "modulation": modulation}

        def draw(trial: int) -> ResourceGrid:
            return draw_grid(system, modulation, seed=suite.seed, trial=trial)

        super().__init__(suite, f"user-{text}-{modulation}", entries, suite.snr_db or (), draw)

    @cached_property
    def content(self) -> str:
        """Digest of radio, channel and modulation, from which all rows follow."""
        system = described_fields(self._system)
        return digest([self._suite.kind, system, canonical_params(self._channel), self._labels])

    def observe(self, snr_db: float, trial: int) -> Arrival:
        """Send a frame, for all receivers."""
        grid, key = self._drawn_once(trial), self._key(snr_db, trial)
        return Arrival(key, self._labels, grid.bits.size, grid, self._system, self._channel)


def user_scenes(
    suite: Suite,
    channels: Sequence[str],
    receivers: Sequence[str],
    modulations: Sequence[Modulation],
    system: System,
) -> list[UserScene]:
    """Plan every channel with every modulation.

    What would fail in every cell of a channel or a receiver is refused. Of a
    channel that moves only the first fade is looked at; a later one with more
    Doppler fails in its own cells.

    Raises
    ------
    InputError
        Naming the channel or the receiver that is unknown, the channel that the closed form does not
        hold for, or the receiver that cannot estimate the channel from the PRS.
    """
    built: dict[str, Channel] = {text: _built("channel", text, CHANNELS) for text in channels}
    equalisers: dict[str, OneTap] = {text: _built("receiver", text, RECEIVERS) for text in receivers}
    entries = distinct_entries("receiver", ((text, entry_of(one)) for text, one in equalisers.items()))
    for text, channel in built.items():
        with _named(f"channels: {text!r}"):
            stream = random_stream("channel", 0, suite.seed, channel.name)
            require_closed_form(system, channel.paths(system, stream))
    for text, receiver in equalisers.items():
        if built and receiver.knowledge == "prs":
            with _named(f"receivers: {text!r}"):
                require_estimable(system, receiver.time_order)
    return [
        UserScene(suite, system, text, channel, modulation, entries)
        for text, channel in built.items()
        for modulation in modulations
    ]


def _built(what: str, text: str, classes: Mapping[str, type[Any]]) -> Any:
    """Channel or receiver that ``name[param=value,...]`` describes."""
    name, params = parse_spec(text)
    if name not in classes:
        raise unknown_name(what, name, classes)
    return construct(what, name, classes[name], params)


@contextmanager
def _named(what: str) -> Iterator[None]:
    """Put what is refused in front of the reason."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{what}: {error}") from error
