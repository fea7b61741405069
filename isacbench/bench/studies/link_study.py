"""The study ``link``: one frame that is sensed with and that a user receives, bit errors beside images.

Two sorts of rows. Those of a scenario are ordinary ones of estimators, which
image the echo of a frame: of all its resource elements or of the PRS alone,
its data of some modulation, divided by what was sent in some way. Those of a
user are of a receiver, which has no cloud and no scores: bits, and how many
of them came out wrong.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import pandas as pd
from scipy.special import bdtr, bdtrc

from isacbench.bench.cells.radio_coordinates import gain_db
from isacbench.bench.cells.statuses import failed
from isacbench.bench.studies.imaging_study import require_scatterers
from isacbench.bench.studies.intervals import mean_band, share_band
from isacbench.bench.studies.link_reception import UserScene, build_channel, build_receiver, require_possible
from isacbench.bench.studies.medians import median_times
from isacbench.bench.studies.study import Entry, ImagedScene, build_estimators, element_snrs_db
from isacbench.errors import InputError
from isacbench.link.sensing.division import Signal
from isacbench.link.sensing.link_observation import SignalSimulator

if TYPE_CHECKING:
    from isacbench.bench.studies.study import Scene
    from isacbench.bench.suites.suite import LinkSuite
    from isacbench.model.numerology import System
    from isacbench.model.scene import Scenario


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
        entries = build_estimators(suite)
        require_scatterers(scenarios)
        scenes: list[Scene] = [
            _sensed_scene(suite, scenario, name, signal, entries)
            for scenario in scenarios.values()
            for name, signal in signals_of(suite).items()
        ]
        system = _common_system(scenarios)
        receivers = [build_receiver(text) for text in suite.receivers]
        channels = {text: build_channel(text) for text in suite.channels}
        if channels:
            require_possible(suite, system, channels, receivers)
        return scenes + [
            UserScene(suite, system, text, channel, modulation, receivers)
            for text, channel in channels.items()
            for modulation in suite.modulations
        ]


def _sensed_scene(
    suite: LinkSuite,
    scenario: Scenario,
    name: str,
    signal: Signal,
    entries: Sequence[Entry[Any]],
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
        entries,
        element_snrs_db(suite, gain_db(scenario)),
        name=f"{scenario.name}-{name}",
        simulator=partial(SignalSimulator, signal=signal),
        labels=labels,
    )


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


def summarise_link(records: pd.DataFrame) -> pd.DataFrame:
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
        (of mean powers) and ``rate_bps``, the mean. Of all
        ``time_estimate_s_median``, as `isacbench.bench.studies.medians.median_times`
        has it. Fewer than five trials have no intervals.
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
        rows.append(row)
    return pd.DataFrame(rows).join(median_times(records, GROUP), on=GROUP)


def outside_interval(summary: pd.DataFrame) -> pd.Series[bool]:
    """Tell which counts of bit errors lie outside the family-wise interval of what was expected.

    Of receivers that know the channel: given the fade, errors of bits are those
    of the closed form, and nearly independent. The family is all their counts.

    Parameters
    ----------
    summary : DataFrame
        As `summarise_link` returns it.

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
    low, high = share_band(n_errors, n_bits, len(part))
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
