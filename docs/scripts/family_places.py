"""Rank sets and mean places of estimators of a population run at one SNR, for a table of docs/estimators.md.

    python docs/scripts/family_places.py results/population 10

The score of a scene is the mean of the deviation over its trials; references have no place. Without an SNR
it is the mean over all of them, as in `isacbench rank`.
"""

import sys
from dataclasses import replace
from pathlib import Path

from isacbench.bench.compare.matching import read_run
from isacbench.bench.compare.ranking import rank_table, rank_text


def places(folder: str, snr_db: float | None = None) -> str:
    """Write the table of a run, as Markdown."""
    run = read_run(Path(folder))
    if snr_db is not None:
        run = replace(run, records=run.records[run.records["snr_db"] == snr_db])
    found = rank_table(run)
    place = found.scores.rank(axis=1)
    table = place.groupby(place.index.str.partition("[").get_level_values(0)).mean().T
    table.insert(0, "all", place.mean())
    ranks = found.ranks[found.ranks["group"] == found.ranks["group"].iloc[0]].set_index(
        ["estimator", "params"]
    )
    lines = [["", "rank", *table.columns], ["---"] * (table.shape[1] + 2)]
    for variant, row in table.sort_values("all").iterrows():
        rank = rank_text(*ranks.loc[variant, ["rank_low", "rank_high"]])
        lines.append([f"`{found.labels[variant]}`", rank, *(f"{value:.1f}" for value in row)])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


if __name__ == "__main__":
    print(places(sys.argv[1], *map(float, sys.argv[2:])))
