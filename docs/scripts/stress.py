"""Put the tables of a stress run into docs/stress.md.

isacbench stress -j 2 -o results/stress
python docs/scripts/stress.py results/stress
"""

from __future__ import annotations

import argparse
from pathlib import Path

import pandas as pd

from isacbench.checking.stress import FAMILIES, PROMISES, TABLE
from isacbench.report.findings import family_grid, promise_grid
from isacbench.report.tables import markdown

PAGE = Path(__file__).resolve().parents[1] / "stress.md"
START, END = "<!-- stress: written by docs/scripts/stress.py -->", "<!-- end -->"


def main(folder: Path) -> None:
    """Read both tables and write them into the page."""
    cases, promises = (pd.read_csv(folder / name) for name in (TABLE, PROMISES))
    parts = [_families()]
    for kind in ("estimator", "detector"):
        parts.append(f"### {kind.capitalize()}s\n")
        parts += [
            markdown(promise_grid(promises[promises["kind"] == kind])),
            markdown(family_grid(cases[cases["kind"] == kind])),
        ]
    page = PAGE.read_text(encoding="utf-8")
    before, _, rest = page.partition(START)
    _, _, after = rest.partition(END)
    PAGE.write_text("\n".join([before + START, "", *parts, END + after]), encoding="utf-8")


def _families() -> str:
    """Every family: what it holds, and what its parameters can be."""
    lines = ["| case | what | parameters | in the table |", "|---|---|---|--:|"]
    for family in FAMILIES.values():
        spaces = "; ".join(f"`{name}`: {space}" for name, space in family.spaces.items())
        lines.append(f"| `{family.name}` | {family.description} | {spaces} | {len(family.table)} |")
    return "\n".join([*lines, ""])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="of a stress run")
    main(parser.parse_args().folder)
