"""Runs of the same scenes as one table: estimators of several runs side by side."""

from collections import ChainMap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from isacbench.bench.compare.pairs import incomparable
from isacbench.bench.compare.scenes import with_ratios
from isacbench.bench.labels import estimator_labels, references_in
from isacbench.bench.store.run import Run
from isacbench.charts import Variant, variants_in
from isacbench.errors import InputError
from isacbench.files.escaping import plural, shortened

RUN = "run"
"""Column of joined rows with the number of their run."""

KEY = ["scenario", "snr_db", "trial"]
SAME = ["deviation", "gospa_m", "n_estimated"]
"""Scores by which two runs of an estimator are recognised as equal."""


@dataclass(frozen=True, eq=False)
class JoinedRuns:
    """Rows of one run, or of several.

    Attributes
    ----------
    runs : sequence of Run
        Labelled by their names in the page.
    table : Run
        Rows of all runs with the column ``run``, the ratios to the oracle and the sums of Hausdorff
        distances. An estimator that several runs have is named after its run, too.
    labels : mapping of (str, str) to str
        Readable names of the estimators of the table.
    specs : mapping of (str, str) to str
        The same without the names of runs: specifications.
    notes : sequence of str
        Estimators and rows that were left out.
    """

    runs: Sequence[Run]
    table: Run
    labels: Mapping[Variant, str]
    specs: Mapping[Variant, str]
    notes: Sequence[str]


def join_runs(runs: Sequence[Run], rename_all: bool = False, only_common: bool = False) -> JoinedRuns:
    """Put the rows of runs of the same scenes, labelled by their names in the page, into one table.

    An estimator that an earlier run has with the same scores is left out, and so are references of later
    runs, which see the truth. With `rename_all` every estimator of several runs that is no reference is kept,
    named after its run. With `only_common` runs with other scenes are refused, and SNRs and trials that not
    all runs have are left out, so that means are over the same cells.
    """
    _require_comparable(runs, only_common)
    own = [estimator_labels(variants_in(run.rows)) for run in runs]
    compared, notes = _common(runs) if only_common else (list(runs), [])
    parts: list[Run] = []
    labels: dict[Variant, str] = {}
    specs: dict[Variant, str] = {}
    first_rows: dict[Variant, pd.DataFrame] = {}
    for number, run in enumerate(compared):
        rows, limits = run.rows.assign(**{RUN: number}), references_in(run.rows)
        is_kept = np.ones(len(rows), dtype=np.bool_)
        for name, params in variants_in(run.rows):
            variant, label = (name, params), own[number][name, params]
            of_variant = ((run.rows["estimator"] == name) & (run.rows["params"] == params)).to_numpy()
            is_shared = name not in limits and sum(variant in other for other in own) > 1
            earlier = first_rows.setdefault(variant, rows[of_variant])
            is_first = earlier[RUN].iloc[0] == number
            is_other = is_shared and (rename_all or not _scores_equal(earlier, rows[of_variant]))
            if not is_first and not is_other:
                is_kept &= ~of_variant
                if name not in limits:
                    first = runs[earlier[RUN].iloc[0]].label
                    notes.append(f"{label} of {run.label} has the same scores as that of {first}")
                continue
            spec, ending = label, f" ({run.label})"
            if is_shared and (rename_all or not is_first):
                name, label = f"{name}{ending}", f"{label}{ending}"
            rows.loc[of_variant, "estimator"] = name
            if label in labels.values():  # parameters of estimators that are not installed
                label = f"{label}{ending}"
            labels[name, params], specs[name, params] = label, spec
        parts.append(run.changed(rows=rows).take(is_kept))
    scenarios = dict(ChainMap(*(run.manifest["scenarios"] for run in runs)))
    joined = Run.joined(parts).changed(manifest={**runs[0].manifest, "scenarios": scenarios})
    if joined.rows.empty:
        raise InputError("the runs have no common page: no SNR and trial is in all of them")
    return JoinedRuns(runs, joined.changed(rows=with_ratios(joined)), labels, specs, notes)


def _require_comparable(runs: Sequence[Run], only_common: bool) -> None:
    """Refuse runs that measured different things, or other scenes."""
    for run in runs[1:]:
        reasons = incomparable(runs[0], run)
        apart = sorted(set(runs[0].rows["scenario"]) ^ set(run.rows["scenario"]))
        if only_common and not reasons and apart:
            reasons = (f"only one of them has the scenes {shortened(', '.join(apart))}",)
        if reasons:
            raise InputError(f"{runs[0].label} and {run.label} have no common page: {'; '.join(reasons)}")


def _common(runs: Sequence[Run]) -> tuple[list[Run], list[str]]:
    """Take the rows of scenes, SNRs and trials that all runs have, and say what is left out."""
    cells = [pd.MultiIndex.from_frame(run.rows[KEY].astype({"scenario": object})) for run in runs]
    parts, notes = [], []
    for run, own in zip(runs, cells, strict=True):
        is_common = np.all([own.isin(other) for other in cells], axis=0)
        if not is_common.all():
            n_other = plural(int((~is_common).sum()), "row")
            notes.append(f"{n_other} of {run.label} left out: not all runs have their SNR and trial")
        parts.append(run.take(is_common))
    return parts, notes


def _scores_equal(one: pd.DataFrame, other: pd.DataFrame) -> bool:
    """Tell whether an estimator has the same cells and scores in two runs."""
    first, second = (table.astype({"scenario": object}).set_index(KEY)[SAME] for table in (one, other))
    return first.index.sort_values().equals(second.index.sort_values()) and np.allclose(
        first, second.reindex(first.index), rtol=1e-9, equal_nan=True
    )
