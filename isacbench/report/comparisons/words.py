"""Wording of a comparison: "regression" for two runs, "worse" for two estimators."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from isacbench.bench.plan.labels import estimator_labels

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping

    from isacbench.bench.compare.comparison import Comparison


class Wording:
    """Names and sentences of one comparison.

    Attributes
    ----------
    heads : (str, str)
        Names of base and new side at the head of a column.
    sides : (str, str)
        Names of both sides in a sentence.
    legend : (str, str)
        Both sides with what distinguishes them, for a figure.
    heading : list of str
        Both sides with the version of their code, one line each.
    outcome : str
        Summary in one phrase: the new side is worse, lacks results, or neither.
    labels : mapping of (str, str) to str
        Names of estimators, by name and parameters.
    unit : {"trial", "scene"}
        Noun for what is paired.
    """

    def __init__(self, comparison: Comparison) -> None:
        self.labels = estimator_labels(comparison.variants)
        self.unit = comparison.unit
        self._is_between = comparison.between is not None
        self._verdicts: dict[str, str] = {}
        versions = comparison.base_version, comparison.new_version
        if comparison.between is None:
            self.heads, self.sides = ("base", "new"), ("the base", "the new run")
            self.legend = f"base: {versions[0]}", f"new: {versions[1]}"
            self.heading = [
                f"base {comparison.base}: isacbench {versions[0]}",
                f"new  {comparison.new}: isacbench {versions[1]}",
            ]
            worse, fine = "regression", "no regression"
        else:
            first, second = (self.labels[variant] for variant in comparison.between)
            self.heads = self.sides = "A", "B"
            self.legend = f"A: {first}", f"B: {second}"
            self.heading = [f"A {first}", f"B {second}", f"in {comparison.base}: isacbench {versions[0]}"]
            self._verdicts = {"regression": "worse", "improvement": "better"}
            worse, fine = f"{second} is worse than {first}", _fine(comparison, first, second)
            if comparison.is_better:
                worse += " in one part and better in another"
        lost = ", but results are missing" if comparison.is_regression else ""
        self.outcome = worse if comparison.is_worse else f"{fine}{lost}"

    def verdict(self, verdict: str) -> str:
        """Name a verdict.

        Parameters
        ----------
        verdict : str
            One of `isacbench.bench.compare.verdicts.VERDICTS`.
        """
        return self._verdicts.get(verdict, verdict)

    def estimators(self, row: Mapping[Hashable, Any]) -> list[str]:
        """Name the estimator of a row.

        Parameters
        ----------
        row : mapping
            Curve, point or cell.

        Returns
        -------
        list of str
            One name, or two for paired estimators; none if two estimators are
            compared, because the heading names them.
        """
        if self._is_between:
            return []
        sides = (row["estimator"], row["params"]), (row["new_estimator"], row["new_params"])
        return list(dict.fromkeys(self.labels[variant] for variant in sides))

    def name(self, row: Mapping[Hashable, Any], before: str = "", after: str = "") -> str:
        """Name the estimators of a row in a sentence.

        Parameters
        ----------
        row : mapping
            Curve, point or cell.
        before, after : str
            Text around the names.

        Returns
        -------
        str
            Empty where `estimators` names none.
        """
        estimators = self.estimators(row)
        return f"{before}{' → '.join(estimators)}{after}" if estimators else ""


def _fine(comparison: Comparison, first: str, second: str) -> str:
    """Outcome of two estimators of which the second one is not worse by any test."""
    curves = comparison.curves[comparison.curves["n_pairs"] > 0]
    if (curves["verdict"] == "improvement").any():
        return f"{second} is better than {first}"
    if len(curves) and curves["is_better"].all():
        return f"{second} is better than {first} everywhere, which is not tested or may be chance"
    return f"no test shows {second} to be worse than {first}"
