"""Tables and JSON of a ranking."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pandas as pd

from isacbench.bench.compare.pairs import VARIANT
from isacbench.bench.compare.ranking import BESIDE, rank_text
from isacbench.bench.compare.scenes import MIN_FAMILY_SCENES
from isacbench.charts import Table, number_or_blank, text_table
from isacbench.files.escaping import counted
from isacbench.report.comparisons.comparison_tables import json_rows, signed

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping

    from isacbench.bench.compare.ranking import Ranking


HEADINGS = {
    "f_score": "F-score",
    "velocity_error_mps": "velocity: error [m/s]",
    "objects_f_score": "objects: F-score",
}
"""Headings of columns beside the ranks."""


def ranking_grids(ranking: Ranking) -> list[Table]:
    """Lay out the ranks and the win probabilities of every group, and the worst scenes."""
    found = []
    for group, ranks in ranking.ranks.groupby("group", sort=False):
        wins = ranking.wins[ranking.wins["group"] == group]
        found.append(_rank_grid(ranking, str(group), ranks))
        if not ranking.is_descriptive:
            found.append(_win_grid(ranking, str(group), ranks, wins))
    return [*found, _worst_grid(ranking)]


def ranking_lines(ranking: Ranking) -> list[str]:
    """Write what the tables do not show: what was left out, and what sets are."""
    return [
        *ranking.notes,
        "of fewer than six scenes, nothing can be said of unseen ones"
        if ranking.is_descriptive
        else "rank sets hold for all estimators of a table at once with 95 % confidence (less with rare "
        "failures), other intervals each by itself; families with fewer than "
        f"{MIN_FAMILY_SCENES} scenes have no table of their own",
    ]


def ranking_content(ranking: Ranking) -> dict[str, Any]:
    """Describe a ranking in terms of JSON.

    Returns
    -------
    dict
        Numbers that are missing are null. Tables as in
        `isacbench.bench.compare.ranking.Ranking`, ``scores`` with a row for
        each scene and estimator.
    """
    scores = ranking.scores.rename_axis("scenario").stack(VARIANT, future_stack=True)
    return {
        "run": {"folder": ranking.run, "version": ranking.version},
        "metric": ranking.metric,
        "better": ranking.better,
        "ranks": json_rows(ranking.ranks),
        "wins": json_rows(ranking.wins),
        "worst": json_rows(ranking.worst),
        "scores": json_rows(pd.DataFrame({"score": scores}).reset_index()),
        "notes": list(ranking.notes),
    }


def _rank_grid(ranking: Ranking, group: str, ranks: pd.DataFrame) -> Table:
    """One row an estimator, references last."""
    shares = [name for name in BESIDE if name in ranks]
    n_scenes = counted(int(ranks["n_scenes"].iloc[0]), "scene")
    what = f"descriptive: {n_scenes}, means" if ranking.is_descriptive else f"{n_scenes}, ranks"
    title = f"{group}: {what} by {ranking.metric}, {ranking.better} is better"
    header = ["estimator", "rank", f"mean {ranking.metric}", *map(_heading, shares)]
    header += ["from the best", "95 % interval"]
    rows = [_rank_row(ranking, row, shares) for row in ranks.to_dict("records")]
    if not ranking.is_descriptive:
        return text_table(title, header, rows)
    kept = [place for place, name in enumerate(header) if name not in ("rank", "95 % interval")]
    return text_table(title, [header[at] for at in kept], [[row[at] for at in kept] for row in rows])


def _heading(column: str) -> str:
    return HEADINGS.get(column, column)


def _rank_row(ranking: Ranking, row: Mapping[Hashable, Any], shares: list[str]) -> list[str]:
    is_reference = row["is_reference"]
    interval = f"{signed(row['change_low'])} to {signed(row['change_high'])}"
    return [
        ranking.labels[row["estimator"], row["params"]],
        "reference" if is_reference else "" if ranking.is_descriptive else rank_text(*_set(row)),
        number_or_blank(row["mean"], "{:.4g}"),
        *(number_or_blank(row[name], "{:.2f}") for name in shares),
        "" if is_reference else signed(row["change"]),
        "" if is_reference or not row["change"] else interval,
    ]


def _set(row: Mapping[Hashable, Any]) -> tuple[float, float]:
    return row["rank_low"], row["rank_high"]


def _win_grid(ranking: Ranking, group: str, ranks: pd.DataFrame, wins: pd.DataFrame) -> Table:
    """One row an estimator, one column each that it is compared with."""
    variants = list(
        ranks.loc[~ranks["is_reference"], ["estimator", "params"]].itertuples(index=False, name=None)
    )
    texts = {
        (row["estimator"], row["params"], row["other"], row["other_params"]): (
            f"{row['probability']:.2f} ({row['low']:.2f}-{row['high']:.2f})"
        )
        for row in wins.to_dict("records")
    }
    return text_table(
        f"{group}: probability that the row is better than the column on an unseen scene, 95 % interval",
        ["better", *(ranking.labels[variant] for variant in variants)],
        [
            [ranking.labels[variant], *(texts.get((*variant, *other), "") for other in variants)]
            for variant in variants
        ],
    )


def _worst_grid(ranking: Ranking) -> Table:
    """One row each scene in which an estimator is worst."""
    rows = [
        [
            ranking.labels[row["estimator"], row["params"]],
            row["scenario"],
            f"{row['score']:.4g}",
            f"{row['cell_score']:.4g}{'' if row['status'] == 'ok' else ' (' + row['status'] + ')'}",
        ]
        for row in ranking.worst.to_dict("records")
    ]
    header = ["estimator", "scene", ranking.metric, "worst image"]
    return text_table(f"worst scenes by {ranking.metric}", header, rows)
