"""Examining: a plugin goes through a case, and every promise of it gets a verdict."""

from __future__ import annotations

import math
import time
from typing import Any, Literal, NamedTuple

from isacbench.checking.contract.findings import raised_at
from isacbench.checking.promises.promise import (
    BrokenPromiseError,
    NotApplicableError,
    Promise,
    refuse_warnings,
)
from isacbench.checking.stress.case import Case
from isacbench.errors import InputError
from isacbench.files.escaping import visible

CaseOutcome = Literal["ok", "refused", "skipped", "failed", "timeout", "killed"]
"""Refused: an `InputError` where that is a proper answer; skipped: says nothing about this plugin."""

BROKEN: frozenset[CaseOutcome] = frozenset({"failed", "timeout", "killed"})
"""Outcomes that are findings."""


class Verdict(NamedTuple):
    """Outcome of a promise.

    Attributes
    ----------
    outcome : {"ok", "refused", "skipped", "failed", "timeout", "killed"}
    drift, bound : float
        Measured distance from the promise, and the largest allowed; NaN where
        nothing was measured.
    message : str
        What is wrong; empty where nothing is.
    """

    promise: str
    outcome: CaseOutcome
    drift: float = math.nan
    bound: float = math.nan
    time_s: float = math.nan
    message: str = ""

    @property
    def severity(self) -> tuple[bool, float]:
        """Key that sorts findings last, then by the share of its bound that a drift takes."""
        share = self.drift / self.bound if self.bound else math.inf if self.drift else 0.0
        return self.outcome in BROKEN, -1.0 if math.isnan(share) else share


def examine(case: Case[Any], plugin: Any, seed: int = 0) -> list[Verdict]:
    """Put a plugin through a case.

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

    verdict = _verdict(Promise("input", 0.0, bring_together), plugin, None, case.may_refuse)
    if not subjects:
        return [verdict]
    verdicts: list[Verdict] = []
    for promise in case.promises:
        verdicts.append(_verdict(promise, plugin, subjects[0], case.may_refuse))
        if verdicts[0].outcome != "ok":
            break
    return verdicts


def _verdict(promise: Promise[Any], plugin: object, subject: Any, may_refuse: bool) -> Verdict:
    start = time.perf_counter()
    drift = bound = math.nan
    outcome: CaseOutcome = "failed"
    try:
        drift, bound = refuse_warnings(lambda: promise.drift(subject)), promise.bound
        message = promise.complaint(drift)
        outcome = "failed" if message else "ok"
    except NotApplicableError as reason:
        outcome, message = "skipped", str(reason)
    except BrokenPromiseError as error:
        message = promise.hinted(str(error))
    except InputError as error:
        outcome, message = "refused" if may_refuse else "failed", str(error)
    except (Exception, SystemExit, KeyboardInterrupt) as error:  # of the plugin: it is alone in its process
        message = raised_at(error, type(plugin).__module__)
    return Verdict(promise.name, outcome, drift, bound, time.perf_counter() - start, visible(message))
