"""Tables of objects: which share of each kind was detected, how many found ones are none, and the errors."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from isacbench.bench.kinds.scores import VARIANT
from isacbench.bench.plan.labels import find_limits
from isacbench.charts import Column, Table
from isacbench.files.escaping import counted
from isacbench.metrics.object_scores import ERRORS, UNITS

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd

    from isacbench.charts import Variant

OBJECT_TOTALS = {
    "objects_f_score": "F-score",
    "objects_detected": "detected",
    "n_objects_false": "false: an image",
}
DETECTED = "detected_"


def object_tables(rows: pd.DataFrame, labels: Mapping[Variant, str]) -> list[Table]:
    """Objects of a run: shares that were detected, and errors, first over all SNRs, then as details at each.

    No tables if no row has scores of objects. Where some scenarios have no objects, the titles say so.
    """
    if "n_objects" not in rows:
        return []
    scored = rows[rows["n_objects"].notna()]
    if scored.empty:
        return []
    without = [name for name in rows["scenario"].unique() if name not in set(scored["scenario"])]
    lack = f"; without {', '.join(without)}, whose points belong to no object" if without else ""
    scenes = counted(scored["scenario"].nunique(), "scene")
    snrs_db = sorted(scored["snr_db"].unique())
    found = [_object_table(scored, labels, f"Objects, {scenes}, {over_snrs(snrs_db)}{lack}")]
    for snr_db in snrs_db if len(snrs_db) > 1 else ():
        part, title = scored[scored["snr_db"] == snr_db], f"Objects, {scenes}, {snr_db:g} dB{lack}"
        found.append(replace(_object_table(part, labels, title), is_detail=True))
    return found


def over_snrs(snrs_db: list[float]) -> str:
    """Say which SNRs a mean is over."""
    listed = f"{', '.join(f'{snr_db:g}' for snr_db in snrs_db)} dB"
    return f"mean over {listed}" if len(snrs_db) > 1 else f"at {listed}"


def detected_kinds(rows: pd.DataFrame) -> list[str]:
    """Kinds of objects that rows have shares of, in the order of columns."""
    names = [name for name in map(str, rows) if name.startswith(DETECTED) and rows[name].notna().any()]
    return [name.removeprefix(DETECTED) for name in names]


def object_means(rows: pd.DataFrame) -> pd.DataFrame:
    """Means over scenes of all scores of objects by estimator; a scene counts once, whatever its images."""
    errors = [f"objects_{error}_{unit}" for error, unit in ERRORS]
    columns = [*OBJECT_TOTALS, *(f"{DETECTED}{kind}" for kind in detected_kinds(rows)), *errors]
    scenes = rows.groupby([*VARIANT, "scenario"], sort=False)[columns].mean()
    return scenes.groupby(VARIANT, sort=False).mean()


def _object_table(rows: pd.DataFrame, labels: Mapping[Variant, str], title: str) -> Table:
    references, means = find_limits(rows), object_means(rows).to_dict("index")
    shown = []
    for variant in (one for one in labels if one in means):
        name = labels[variant]
        is_marked = variant[0] not in references or name.endswith("(ref.)")
        shown.append({"label": name if is_marked else f"{name} (ref.)", **means[variant]})
    columns = [Column("estimator", "label", part=0)]
    for column, heading in OBJECT_TOTALS.items():
        columns.append(
            _share(heading, column, 0) if column == "objects_detected" else Column(heading, column, "{:.2f}")
        )
    kinds = detected_kinds(rows)
    columns += [_share(kind.replace("_", " "), f"{DETECTED}{kind}", 2 + at) for at, kind in enumerate(kinds)]
    columns += [
        Column(f"{error} [{UNITS[unit]}]", f"objects_{error}_{unit}", "{:.2f}", optional=2 + len(kinds))
        for error, unit in ERRORS
    ]
    return Table(title, columns, shown)


def _share(heading: str, column: str, optional: int) -> Column:
    return Column(heading, column, "{:.0f} %", scale=100, optional=optional)
