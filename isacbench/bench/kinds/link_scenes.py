"""Scenes of the kind ``link``: scenarios that a frame senses, and users who receive it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from typing import Any, ClassVar, get_args

from isacbench.bench.cells.cell import Found
from isacbench.bench.cells.record import status_of
from isacbench.bench.kinds import scenes
from isacbench.bench.kinds.scenes import Entry, ImagingTask, Shared, Task
from isacbench.bench.suites.scenario_digest import described_fields, digest
from isacbench.bench.suites.suite import Distinct, Listed, Suite
from isacbench.choices import Division, Modulation, Sensing
from isacbench.errors import InputError, unknown_name
from isacbench.link.reception.channel import Awgn, Channel, TappedDelay, TwoRay, require_closed_form
from isacbench.link.reception.channel_estimation import require_estimable
from isacbench.link.reception.receiver import Knowledge, Reception, expected_ber, receive
from isacbench.link.sensing.division import Signal
from isacbench.link.sensing.link_observation import SignalSimulator
from isacbench.link.waveform.figures_of_merit import frame_rates
from isacbench.link.waveform.resource_grid import draw_grid
from isacbench.model.cloud import PointCloud
from isacbench.model.echo import random_stream
from isacbench.model.numerology import System
from isacbench.model.scene import Scenario
from isacbench.plugins.registry import canonical_params, construct
from isacbench.specifications import parse_spec


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


class ReceptionTask(Task):
    """Channel (`text` as the suite writes it), modulation, and the receivers behind them."""

    def __init__(
        self,
        suite: LinkSuite,
        system: System,
        channel: Channel,
        text: str,
        modulation: Modulation,
        entries: Sequence[Entry[OneTap]],
    ) -> None:
        self._system, self._channel = system, channel
        self._labels = {"channel": text, "modulation": modulation}
        super().__init__(
            suite,
            f"user-{text}-{modulation}",
            entries,
            suite.snr_db or (),
            lambda trial: draw_grid(system, modulation, seed=suite.seed, trial=trial),
        )

    @cached_property
    def content(self) -> str:
        """Digest of radio, channel and modulation, from which all rows follow."""
        system = described_fields(self._system)
        return digest([self._suite.kind, system, canonical_params(self._channel), self._labels])

    def observe(self, snr_db: float, trial: int) -> Shared:
        """Send a frame, for all receivers."""
        grid = self._drawn_once(trial)
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
    """Signals that the scenarios of a suite are sensed with, by a short name, each once.

    Where all symbols that are sensed with have the same power, all divisions
    are the same; and of the PRS, which is QPSK always, all modulations.

    Names are such as ``all-qpsk``, ``all-16qam-matched`` and ``prs``.
    """
    signals: dict[str, Signal] = {}
    for sensing, modulation, division in product(suite.sensing, suite.modulations, suite.divisions):
        signal = Signal(modulation, sensing, division)
        name = "prs" if sensing == "prs" else f"{sensing}-{modulation}"
        if sensing != "prs" and not signal.has_unit_modulus:
            name += f"-{division}"
        signals.setdefault(name, signal)
    return signals


def plan_scenes(suite: LinkSuite, scenarios: Mapping[str, Scenario]) -> list[Task]:
    """Plan every scenario with every signal, and every channel with every modulation.

    What would fail in every cell is refused.
    """
    if suite.snr_db is None:
        raise InputError(
            "snr_gain_db: a suite of the kind link takes snr_db, because a user has no array gain"
        )
    entries = scenes.build_estimators(suite)
    found: list[Task] = []
    for scenario in scenarios.values():
        scenario.require_default("a suite of the kind link", "noise", "mimo")
    for scenario, (short, signal) in product(scenarios.values(), signals_of(suite).items()):
        labels = {
            "template": scenario.name,
            "modulation": "" if signal.sensing == "prs" else signal.modulation,
            "sensing": signal.sensing,
            "division": "" if signal.has_unit_modulus else signal.division,
        }
        name, simulator = f"{scenario.name}-{short}", partial(SignalSimulator, signal=signal)
        found.append(ImagingTask(suite, scenario, entries, name=name, simulator=simulator, labels=labels))
    (first, scenario), *others = scenarios.items()
    for name, other in others:
        if other.system != scenario.system:
            raise InputError(
                f"scenarios: {first!r} and {name!r} have different systems; a suite of the kind link takes "
                "scenarios of one system, whose frame the user receives"
            )
    return [*found, *_user_scenes(suite, scenario.system)]


def _user_scenes(suite: LinkSuite, system: System) -> list[ReceptionTask]:
    """Every channel with every modulation, all receivers behind them.

    Refused are unknown channels and receivers, a channel that the closed form does not hold for, and a
    receiver that cannot estimate the channel from the PRS. Of a channel that moves only the first fade is
    looked at; a later one with more Doppler fails in its own cells.
    """
    built: dict[str, Channel] = {text: _built("channel", text, CHANNELS) for text in suite.channels}
    equalisers: dict[str, OneTap] = {text: _built("receiver", text, RECEIVERS) for text in suite.receivers}
    receivers = ((text, scenes.entry_of(one)) for text, one in equalisers.items())
    entries = scenes.distinct_entries("receiver", receivers)
    for text, channel in built.items():
        with _named(f"channels: {text!r}"):
            stream = random_stream("channel", 0, suite.seed, channel.name)
            require_closed_form(system, channel.paths(system, stream))
    for text, receiver in equalisers.items():
        if built and receiver.knowledge == "prs":
            with _named(f"receivers: {text!r}"):
                require_estimable(system, receiver.time_order)
    return [
        ReceptionTask(suite, system, channel, text, modulation, entries)
        for (text, channel), modulation in product(built.items(), suite.modulations)
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
