"""Examining: a plugin goes through a case, and every promise of it gets a verdict."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from isacbench.checking.contract.conduct import refuse_warnings
from isacbench.checking.contract.findings import BrokenContractError, raised_at
from isacbench.checking.stress.case import BrokenPromiseError, NotApplicableError, Promise
from isacbench.errors import InputError
from isacbench.files.escaping import visible

if TYPE_CHECKING:
    from isacbench.checking.stress.case import Case

CaseOutcome = Literal["ok", "refused", "skipped", "failed", "timeout", "killed"]
"""Refused: an `InputError` where that is a proper answer; skipped: says nothing about this plugin."""

BROKEN: frozenset[CaseOutcome] = frozenset({"failed", "timeout", "killed"})
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
    outcome: CaseOutcome
    drift: float
    bound: float
    time_s: float
    message: str = ""

    @property
    def severity(self) -> tuple[bool, float]:
        """Sorts verdicts: findings last, then by the share of its bound that a drift takes."""
        if not self.bound:
            return self.outcome in BROKEN, math.inf if self.drift > 0 else 0.0 if self.drift == 0 else -1.0
        share = self.drift / self.bound
        return self.outcome in BROKEN, share if share == share else -1.0


def examine(case: Case[Any], plugin: Any, seed: int = 0) -> list[Verdict]:
    """Put a plugin through a case.

    Parameters
    ----------
    case : Case
    plugin : Estimator or Detector
    seed : int

    Returns
    -------
    list of Verdict
        One a promise; the first alone where that is broken or refused, and
        one of the "input" where plugin and case do not come together.
    """
    subjects: list[Any] = []

    def bring_together(_: None) -> float:
        subjects.append(case.subject(plugin, seed))
        return 0.0

    verdict = _verdict(Promise("input", 0.0, bring_together), None, case.may_refuse)
    if not subjects:
        return [verdict]
    (subject,) = subjects
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
    except (
        Exception,
        SystemExit,
        KeyboardInterrupt,
    ) as error:  # of the plugin: nobody else is in its process
        return _unmeasured(promise.name, "failed", start, raised_at(error))
    outcome: CaseOutcome = "ok" if drift <= promise.bound else "failed"
    message = "" if outcome == "ok" else f"off by {drift:.2g}, allowed are {promise.bound:.2g}"
    return Verdict(promise.name, outcome, drift, promise.bound, time.perf_counter() - start, message)


def _unmeasured(promise: str, outcome: CaseOutcome, start: float, message: str) -> Verdict:
    return Verdict(
        promise, outcome, float("nan"), float("nan"), time.perf_counter() - start, visible(message)
    )
