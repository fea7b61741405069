"""Examining: a plugin goes through a case, and every promise of it gets a verdict."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from isacbench.conformance.conduct import refuse_warnings
from isacbench.conformance.findings import BrokenContractError, raised_at
from isacbench.errors import InputError
from isacbench.stress.case import BrokenPromiseError, NotApplicableError

if TYPE_CHECKING:
    from isacbench.stress.case import Case, Promise

__all__ = ["BROKEN", "Outcome", "Verdict", "examine"]

Outcome = Literal["ok", "refused", "skipped", "failed", "timeout", "killed"]
"""Refused: an `InputError` where that is a proper answer; skipped: says nothing about this plugin."""

BROKEN: frozenset[Outcome] = frozenset({"failed", "timeout", "killed"})
"""Outcomes that are findings."""


class Verdict(NamedTuple):
    """How a promise fared.

    Attributes
    ----------
    promise : str
    outcome : {"ok", "refused", "skipped", "failed", "timeout", "killed"}
    drift, bound : float
        How far from what was promised, and how far is allowed; NaN where
        nothing could be measured.
    time_s : float
    message : str
        What is wrong; empty where nothing is.
    """

    promise: str
    outcome: Outcome
    drift: float
    bound: float
    time_s: float
    message: str = ""

    @property
    def severity(self) -> tuple[bool, float]:
        """Sorts verdicts: findings last, then by the share of its bound that a drift takes."""
        share = self.drift / self.bound if self.bound else self.drift
        return self.outcome in BROKEN, share if share == share else -1.0


def examine(case: Case[Any], plugin: Any, seed: int = 0) -> list[Verdict]:
    """Put a plugin through a case.

    Parameters
    ----------
    case : Case
    plugin : Estimator, TruthEstimator or Detector
    seed : int

    Returns
    -------
    list of Verdict
        One a promise; the first alone where that is broken, refused or says
        nothing about this plugin.
    """
    start = time.perf_counter()
    try:
        subject = case.subject(plugin, seed)
    except NotApplicableError as reason:
        return [_unmeasured("input", "skipped", start, str(reason))]
    verdicts: list[Verdict] = []
    for promise in case.promises:
        verdicts.append(_verdict(promise, subject, case.may_refuse))
        if verdicts[0].outcome != "ok":
            break
    return verdicts


def _verdict(promise: Promise[Any], subject: Any, may_refuse: bool) -> Verdict:
    start = time.perf_counter()
    try:
        drift = refuse_warnings(lambda: promise.drift(subject))
    except NotApplicableError as reason:
        return _unmeasured(promise.name, "skipped", start, str(reason))
    except (BrokenPromiseError, BrokenContractError) as error:
        return _unmeasured(promise.name, "failed", start, str(error))
    except InputError as error:
        return _unmeasured(promise.name, "refused" if may_refuse else "failed", start, str(error))
    except Exception as error:
        return _unmeasured(promise.name, "failed", start, raised_at(error))
    outcome: Outcome = "ok" if drift <= promise.bound else "failed"
    message = "" if outcome == "ok" else f"off by {drift:.2g}, allowed are {promise.bound:.2g}"
    return Verdict(promise.name, outcome, drift, promise.bound, time.perf_counter() - start, message)


def _unmeasured(promise: str, outcome: Outcome, start: float, message: str) -> Verdict:
    return Verdict(promise, outcome, float("nan"), float("nan"), time.perf_counter() - start, message)
