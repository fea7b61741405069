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
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.special import bdtr, bdtrc

from isacbench.bench.cells.statuses import failed
from isacbench.bench.studies.intervals import mean_band, share_band
from isacbench.bench.studies.link_reception import user_scenes
from isacbench.bench.studies.medians import summarise
from isacbench.bench.studies.study import (
    ImagedScene,
    Scene,
    build_estimators,
    element_snrs_db,
    require_scatterers,
)
from isacbench.errors import InputError
from isacbench.link.sensing.division import Signal
from isacbench.link.sensing.link_observation import SignalSimulator
from isacbench.model.radio_coordinates import gain_db

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from isacbench.bench.studies.study import Entry
    from isacbench.bench.suites.link_kind import LinkSuite
    from isacbench.model.numerology import System
    from isacbench.model.scene import Scenario

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

FAMILY_CONFIDENCE = 0.99
"""Confidence of the interval that all counts of bit errors of a run are compared with together."""


def link_scenes(suite: LinkSuite, scenarios: Mapping[str, Scenario]) -> list[Scene]:
    """Plan every scenario with every signal, and every channel with every modulation.

    Parameters
    ----------
    suite : LinkSuite
    scenarios : mapping of str to Scenario
        By name.

    Returns
    -------
    list of Scene

    Raises
    ------
    InputError
        If the suite gives SNRs after gain, a scenario has no scatterers, the scenarios have
        different systems, or a channel or a receiver is not possible.
    """
    if suite.snr_db is None:
        raise InputError(
            "snr_gain_db: a suite of the kind link takes snr_db, because a user has no array gain"
        )
    entries = build_estimators(suite)
    require_scatterers(scenarios)
    for scenario in scenarios.values():
        scenario.require_default("a suite of the kind link", "noise", "mimo")
    sensed: list[Scene] = [
        _sensed_scene(suite, scenario, name, signal, entries)
        for scenario in scenarios.values()
        for name, signal in signals_of(suite).items()
    ]
    return sensed + user_scenes(suite, _common_system(scenarios))


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


def _sensed_scene(
    suite: LinkSuite,
    scenario: Scenario,
    name: str,
    signal: Signal,
    entries: Sequence[Entry[Any]],
) -> ImagedScene:
    """Scene of a scenario that is sensed with a signal."""
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
    """Radio of the scenarios, whose frame the user receives; all must have the same."""
    (first, scenario), *others = scenarios.items()
    for name, other in others:
        if other.system != scenario.system:
            raise InputError(
                f"scenarios: {first!r} and {name!r} have different systems; a suite of the kind link takes "
                "scenarios of one system, whose frame the user receives"
            )
    return scenario.system


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
    return summarise(records, GROUP, _numbers)


def _numbers(part: pd.DataFrame) -> dict[str, Any]:
    """Numbers of one group: of what was received, or of what was imaged."""
    broken = failed(part)
    of_kind = _received if part["channel"].iloc[0] else _imaged
    return {"n_cells": len(part), "n_failed": int(broken.sum()), **of_kind(part[~broken])}


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
