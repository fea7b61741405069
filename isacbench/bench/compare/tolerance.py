"""Tolerances of a comparison: how much worse a score may get, and which direction is worse."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from isacbench.bench.cells.record import REFERENCE_COLUMNS
from isacbench.bench.suites.suite_kinds import KINDS
from isacbench.errors import InputError, unknown_name
from isacbench.metrics.descriptions import ScoreColumn

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from isacbench.metrics.descriptions import Direction

FORM = re.compile(
    r"\s*(?P<metric>\w+)\s*=\s*(?P<number>([0-9]+\.?[0-9]*|\.[0-9]+)(e[+-]?[0-9]+)?)\s*(?P<percent>%?)\s*",
    re.IGNORECASE,
)

NEITHER = "seed", "timing", "time_spread_s", *REFERENCE_COLUMNS
"""Columns of every run for which neither direction is better."""


@dataclass(frozen=True)
class Tolerance:
    """Limit to how much worse the mean of a score may get.

    Attributes
    ----------
    metric : str
        Column of the records.
    limit : float
        At least 0: a fraction of the base's mean, or in units of the score.
    is_relative : bool
        Whether it is a fraction.
    """

    metric: str
    limit: float
    is_relative: bool

    def __str__(self) -> str:
        """Spell it as the command line takes it."""
        return f"{self.metric}={100 * self.limit:g}%" if self.is_relative else f"{self.metric}={self.limit:g}"


DEFAULT_TOLERANCE = Tolerance("deviation", 0.05, is_relative=True)


def parse_tolerance(text: str) -> Tolerance:
    """Parse ``NAME=5%``, relative to the base's mean, or ``NAME=0.5``, in units of the score.

    Raises
    ------
    InputError
        Quoting the text and saying what is allowed.

    Examples
    --------
    >>> parse_tolerance("deviation=5%")
    Tolerance(metric='deviation', limit=0.05, is_relative=True)
    """
    match = FORM.fullmatch(text)
    if match is None:
        raise InputError(
            f"tolerance {text!r}: allowed is NAME=NUMBER% of the base's mean or NAME=NUMBER in units of the "
            "score, a number of at least 0, such as deviation=5% or hausdorff_xy_m=0.5"
        )
    number, is_relative = float(match["number"]), bool(match["percent"])
    return Tolerance(match["metric"], number / 100 if is_relative else number, is_relative)


def merge_tolerances(given: Iterable[Tolerance]) -> tuple[Tolerance, ...]:
    """Add tolerances to the default one; the last one for a score counts.

    Examples
    --------
    >>> [str(one) for one in merge_tolerances([parse_tolerance("recall=0.1")])]
    ['deviation=5%', 'recall=0.1']
    """
    return tuple({one.metric: one for one in (DEFAULT_TOLERANCE, *given)}.values())


def direction(
    column: str, described: Mapping[str, ScoreColumn], columns: Collection[str]
) -> Literal["lower", "higher"]:
    """Better direction of a column: lower, where nothing else is known.

    Parameters
    ----------
    described : mapping of str to ScoreColumn
        Columns of the run's metrics, as `isacbench.bench.store.manifest.stored_columns` has them.
    columns : collection of str
        Numeric columns that the runs have.

    Returns
    -------
    {"lower", "higher"}

    Raises
    ------
    InputError
        If there is no such column, or neither direction is better.

    Examples
    --------
    >>> direction("recall", {"recall": ScoreColumn("recall", "", better="higher")}, ["deviation", "recall"])
    'higher'
    """
    known: dict[str, Direction] = dict.fromkeys(NEITHER, "neither")
    known |= {name: score.better for name, score in described.items()}
    for kind in KINDS.values():
        known |= kind.better
    scores = [name for name in columns if known.get(name, "lower") != "neither"]
    if column not in columns:
        raise unknown_name("score", column, scores)
    better = known.get(column, "lower")
    if better == "neither":
        raise InputError(f"{column} has no better direction; allowed are {', '.join(scores)}")
    return better
