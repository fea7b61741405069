"""Mean place of each estimator of a population run, by family of scenes: a table of docs/estimators.md.

    python docs/scripts/family_places.py results/population

The score of a scene is the mean of the deviation over its SNRs and trials; references have no place.
"""

import sys

import isacbench


def places(folder: str) -> str:
    """Write the table of a run, as Markdown."""
    found = isacbench.rank(folder)
    place = found.scores.rank(axis=1)
    place.columns = [found.labels[variant] for variant in place.columns]
    table = place.groupby(place.index.str.partition("[").get_level_values(0)).mean().T
    table.insert(0, "all", place.mean())
    lines = [["", *table.columns], ["---"] * (table.shape[1] + 1)]
    for name, row in table.sort_values("all").iterrows():
        lines.append([f"`{name}`", *(f"{value:.1f}" for value in row)])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


if __name__ == "__main__":
    print(places(sys.argv[1]))
