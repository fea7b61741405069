"""Result of a comparison: tables of curves and points with their verdicts, and what became of cells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from isacbench.bench.compare.estimator_pairs import spell_apart

if TYPE_CHECKING:
    from collections.abc import Callable

    import pandas as pd

    from isacbench.bench.compare.matching import CellChanges
    from isacbench.bench.compare.tolerance import Tolerance
    from isacbench.bench.plan.labels import Variant

VERDICTS = ("regression", "improvement", "inconclusive", "same")


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """Changes from a base to a new run, or from one estimator of a run to another.

    `isacbench.compare` makes it. All tables name an estimator by ``estimator``
    and ``params`` (canonical JSON) of the base; ``new_estimator`` and
    ``new_params`` differ where a map or a match paired it with another one.

    Attributes
    ----------
    base, new : str
        Folders of the runs.
    base_version, new_version : str
        Of the code that made them.
    between : tuple of (str, str), or None
        Name and params of both estimators, where two of one run are compared:
        the first one is the base.
    variants : tuple of (str, str)
        Name and params of every estimator in either run.
    alpha : float
        Largest probability that any regression is reported between runs that
        differ by chance alone; likewise any improvement.
    tolerances : tuple of Tolerance
        Scores that are compared, and by how much each may get worse.
    curves : DataFrame
        A row for each metric, scenario, estimator and params: ``n_snr``,
        ``n_pairs`` (trials); mean and half width of its 95 % confidence band
        (Student's t) of both runs, ``base_mean``, ``base_band``,
        ``new_mean``, ``new_band``; ``change`` and ``relative``, the change
        over the base's mean, each with the limits ``_low`` and ``_high`` of
        its 95 % bootstrap interval; ``p_worse`` and ``p_better``, corrected
        for all tests made; ``smallest_effect``, the change of the mean, in
        units of the score, that so many trials would have shown with 80 %
        power, and ``trials_needed`` to show any; ``limit``, the tolerance in
        units of the score; ``verdict``, one of `VERDICTS`.
    points : DataFrame
        The same for each SNR ``snr_db``. A curve of a single SNR
        (``n_snr = 1``) is tested once: its point has the curve's p-values.
    cells : CellChanges
        Numbers of paired cells, and tables of cells that failed or are there
        on one side alone.
    n_lost_scores : int
        Scores that the base has and the new run has not, of cells that both
        delivered.
    notes : tuple of str
        Parts that were not compared, each with the reason.
    """

    base: str
    new: str
    base_version: str
    new_version: str
    between: tuple[Variant, Variant] | None
    variants: tuple[Variant, ...]
    alpha: float
    tolerances: tuple[Tolerance, ...]
    curves: pd.DataFrame
    points: pd.DataFrame
    cells: CellChanges
    n_lost_scores: int
    notes: tuple[str, ...]

    @property
    def is_regression(self) -> bool:
        """Tell whether a curve or point got worse, or a cell or a score failed or went missing."""
        worse = any((table["verdict"] == "regression").any() for table in (self.curves, self.points))
        return bool(worse or self.n_lost_scores or len(self.cells.new_failures) or len(self.cells.missing))

    def __repr__(self) -> str:
        """Show what was compared, the verdict, and counts of curves, points and cells."""
        sides = f"{self.base!r} and {self.new!r}"
        if self.between is not None:
            sides = f"{' and '.join(spell_apart(self.between))} of {self.base!r}"
        curves, points = (verdict_counts(table) or "none" for table in (self.curves, self.points))
        return (
            f"<Comparison of {sides}: {'regression' if self.is_regression else 'no regression'}\n"
            f" curves: {curves}; points: {points}\n"
            f" cells: {self.cells.n_paired} paired, {len(self.cells.new_failures)} failed anew, "
            f"{len(self.cells.missing)} missing>"
        )


def verdict_counts(table: pd.DataFrame, name: Callable[[str], str] = str) -> str:
    """Count the verdicts of curves or points, the worst first, each by its name."""
    counts = table["verdict"].value_counts()
    return ", ".join(f"{counts[verdict]} {name(verdict)}" for verdict in VERDICTS if verdict in counts)
