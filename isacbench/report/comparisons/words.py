"""Words for a comparison: of two runs a regression, of two estimators one that is worse than the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from isacbench.bench.plan.labels import estimator_labels

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping

    from isacbench.bench.compare.comparison import Comparison


class Words(NamedTuple):
    """Words for both sides, for verdicts, and for cells.

    Attributes
    ----------
    base, new : str
        Heads of columns.
    regression, improvement : str
        Verdicts; the others are the same for all.
    failed, missing, repaired, added, failed_both : str
        Cells, as `isacbench.bench.compare.matching.CellChanges` has them.
    lost : str
        Scores that the base alone has.
    """

    base: str
    new: str
    regression: str
    improvement: str
    failed: str
    missing: str
    repaired: str
    added: str
    failed_both: str
    lost: str


OF_RUNS = Words(
    base="base",
    new="new",
    regression="regression",
    improvement="improvement",
    failed="failed anew",
    missing="missing in the new run",
    repaired="repaired",
    added="added by the new run",
    failed_both="failed in both runs, left out",
    lost="lost",
)
OF_ESTIMATORS = Words(
    base="A",
    new="B",
    regression="worse",
    improvement="better",
    failed="failed with B alone",
    missing="that B does not have",
    repaired="failed with A alone",
    added="that A does not have",
    failed_both="failed with both, left out",
    lost="that A alone has",
)


@dataclass(frozen=True)
class Wording:
    """Names and sentences of one comparison.

    Attributes
    ----------
    words : Words
    legend : (str, str)
        Both sides with what tells them apart, for a figure.
    heading : tuple of str
        Both sides with the code that made them, a line each.
    outcome : str
        Whether the new side is worse.
    labels : mapping of (str, str) to str
        Names of estimators, by name and parameters.
    is_between : bool
        Whether all rows are of one pair of estimators.
    """

    words: Words
    legend: tuple[str, str]
    heading: tuple[str, ...]
    outcome: str
    labels: Mapping[tuple[str, str], str]
    is_between: bool

    def verdict(self, verdict: str) -> str:
        """Say a verdict."""
        return {"regression": self.words.regression, "improvement": self.words.improvement}.get(
            verdict, verdict
        )

    def estimators(self, row: Mapping[Hashable, Any]) -> list[str]:
        """Name the estimator of a row: none where it goes without saying, two where they are a pair."""
        if self.is_between:
            return []
        sides = [row["estimator"], row["params"]], [row["new_estimator"], row["new_params"]]
        return list(dict.fromkeys(self.labels[name, params] for name, params in sides))

    def name(self, row: Mapping[Hashable, Any], before: str = "", after: str = "") -> str:
        """Name the estimators of a row in a sentence, or leave them out where they go without saying."""
        estimators = self.estimators(row)
        return f"{before}{' → '.join(estimators)}{after}" if estimators else ""


def wording(comparison: Comparison) -> Wording:
    """Choose the words for a comparison."""
    labels = estimator_labels(comparison.variants)
    if comparison.between is None:
        versions = comparison.base_version, comparison.new_version
        return Wording(
            OF_RUNS,
            legend=(f"base: {versions[0]}", f"new: {versions[1]}"),
            heading=(
                f"base {comparison.base}: isacbench {versions[0]}",
                f"new  {comparison.new}: isacbench {versions[1]}",
            ),
            outcome="regression" if comparison.is_regression else "no regression",
            labels=labels,
            is_between=False,
        )
    first, second = (labels[variant] for variant in comparison.between)
    return Wording(
        OF_ESTIMATORS,
        legend=(f"A: {first}", f"B: {second}"),
        heading=(f"A {first}", f"B {second}", f"in {comparison.base}: isacbench {comparison.base_version}"),
        outcome=f"{second} is {'worse' if comparison.is_regression else 'not worse'} than {first}",
        labels=labels,
        is_between=True,
    )
