"""Tables of objects: which share of each kind was detected, how many found ones are none, and the errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pandas as pd

from isacbench.bench.plan.labels import find_limits
from isacbench.files.escaping import counted
from isacbench.metrics.object_scores import ERRORS, UNITS
from isacbench.report.tables.run_tables import Grid, written

if TYPE_CHECKING:
    from collections.abc import Mapping

    from isacbench.bench.plan.labels import Variant

DETECTED = "detected_"
COUNTED = "n_objects"
TOTALS = {"objects_f_score": "F-score", "objects_detected": "detected", "n_objects_false": "false: an image"}


def object_grids(records: pd.DataFrame, labels: Mapping[Variant, str]) -> list[Grid]:
    """Lay out the objects of a run: first over all SNRs, then, not for the terminal, at each.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.
    labels : mapping of (str, str) to str
        Labels of the estimators, in the order of the rows.

    Returns
    -------
    list of Grid
        Empty if no row has scores of objects. Where some scenarios have no objects, the titles say so.
    """
    if COUNTED not in records:
        return []
    scored = records[records[COUNTED].notna()]
    without = [name for name in records["scenario"].unique() if name not in set(scored["scenario"])]
    lack = f"; without {', '.join(without)}, whose points belong to no object" if without else ""
    if scored.empty:
        return []
    snrs_db = sorted(scored["snr_db"].unique())
    over = f"{', '.join(f'{snr_db:g}' for snr_db in snrs_db)} dB"
    over = f"mean over {over}" if len(snrs_db) > 1 else f"at {over}"
    n_scenes = counted(scored["scenario"].nunique(), "scene")
    grids = [_grid(scored, labels, f"Objects, {n_scenes}, {over}{lack}")]
    for snr_db in snrs_db if len(snrs_db) > 1 else ():
        part = scored[scored["snr_db"] == snr_db]
        grids.append(
            _grid(part, labels, f"Objects, {n_scenes}, {snr_db:g} dB{lack}")._replace(is_detail=True)
        )
    return grids


def detected_kinds(records: pd.DataFrame) -> list[str]:
    """Kinds of objects that rows have shares of, in the order of columns.

    Parameters
    ----------
    records : DataFrame

    Returns
    -------
    list of str
    """
    names = [name for name in map(str, records) if name.startswith(DETECTED) and records[name].notna().any()]
    return [name.removeprefix(DETECTED) for name in names]


def object_means(records: pd.DataFrame) -> pd.DataFrame:
    """Means over scenes of all scores of objects; a scene counts once, however many images it has.

    Parameters
    ----------
    records : DataFrame

    Returns
    -------
    DataFrame
        A row for each estimator, indexed by name and parameters.
    """
    errors = [f"objects_{error}_{unit}" for error, unit in ERRORS]
    columns = [*TOTALS, *(f"{DETECTED}{kind}" for kind in detected_kinds(records)), *errors]
    scenes = records.groupby(["estimator", "params", "scenario"], sort=False)[columns].mean()
    return scenes.groupby(["estimator", "params"], sort=False).mean()


def _grid(records: pd.DataFrame, labels: Mapping[Variant, str], title: str) -> Grid:
    kinds, references = detected_kinds(records), find_limits(records)
    header = ["estimator", *TOTALS.values(), *(kind.replace("_", " ") for kind in kinds)]
    header += [f"{error} [{UNITS[unit]}]" for error, unit in ERRORS]
    forms = ["{:.2f}", "{:.0f} %", "{:.2f}", *["{:.0f} %"] * len(kinds), *["{:.2f}"] * len(ERRORS)]
    means, rows = object_means(records), []
    for variant in (one for one in labels if one in means.index):
        name = labels[variant]
        if variant[0] in references and not name.endswith("(ref.)"):
            name += " (ref.)"
        numbers = zip(means.loc[[variant]].to_numpy()[0].tolist(), forms, strict=True)
        rows.append([name, *(written(100 * mean if "%" in form else mean, form) for mean, form in numbers)])
    first = 1 + len(TOTALS)
    errors = [first + len(kinds) + place for place in range(len(ERRORS))]
    return Grid(title, header, rows, [*([first + place] for place in range(len(kinds))), errors])
