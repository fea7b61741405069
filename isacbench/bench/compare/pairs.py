"""Pairs of a comparison, estimators and cells of two runs, and reasons why runs cannot be compared.

Estimators are found in the runs that hold them; their plugins need not be installed.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from isacbench.bench.cells.provenance import differing_versions
from isacbench.bench.cells.rows import CLOUD_KEYS as CELL
from isacbench.bench.cells.rows import SCORED
from isacbench.bench.labels import estimator_labels
from isacbench.bench.store.manifest import SCORES, spell_metric
from isacbench.bench.store.run import Run
from isacbench.charts import VARIANT, Variant, variants_in
from isacbench.errors import InputError, did_you_mean
from isacbench.files.escaping import shortened
from isacbench.specifications import Spec, parse_spec, spell_spec

CURVE = ["scenario", *VARIANT]

MAX_LISTED = 10
"""Variants that a message lists."""


class NotComparableError(ValueError):
    """The two runs measured different things.

    Attributes
    ----------
    reasons : tuple of str
        All reasons, in words.
    """

    def __init__(self, reasons: tuple[str, ...]) -> None:
        super().__init__("; ".join(reasons))
        self.reasons = reasons


def code_version(manifest: Mapping[str, Any]) -> str:
    """Version of the code that made a run, with its commit where it is known."""
    version, git = str(manifest.get("isacbench", "unknown version")), manifest.get("git")
    if not git or not git.get("commit"):
        return version
    return f"{version} ({git['commit'][:10]}{', changed' if git.get('dirty') else ''})"


def incomparable(base: Run, new: Run) -> tuple[str, ...]:
    """Find every reason why two runs cannot be compared, in words; different code is not a reason."""
    (before, contents), (after, others) = (_properties(run) for run in (base, new))
    differing = [
        f"{what} differs: {value} in {base.label}, {after[what]} in {new.label}"
        for what, value in before.items()
        if what in after and value != after[what]
    ]
    edited = [name for name in contents if name in others and contents[name] != others[name]]
    return (*differing, *(f"scenario {name} has another content" for name in edited))


def _properties(run: Run) -> tuple[dict[str, Any], dict[str, set[str]]]:
    """Properties that must be equal to be compared: in words, and digests of each scenario's content."""
    suite, metrics = run.manifest["suite"], run.manifest[SCORES]["metrics"]
    words = {
        "the suite": suite.get("name"),
        "the kind of suite": suite.get("kind"),
        "the seed": run.manifest["seed"],
        **{f"the metric {name}": spell_metric(metric) for name, metric in metrics.items()},
    }
    contents = {name: {described.get("content")} for name, described in run.manifest["scenarios"].items()}
    rows = run.rows[["scenario", "scenario_content"]].drop_duplicates().dropna()
    for name, content in rows.itertuples(index=False):
        contents.setdefault(name, set()).add(content)
    return words, contents


def parse_map(text: str) -> tuple[str, str]:
    """Cut ``OLD[param=value,...]=NEW[param=value,...]`` into its two specifications.

    Examples
    --------
    >>> parse_map("music2d[pfa=1e-3]=music2d[pfa=1e-4]")
    ('music2d[pfa=1e-3]', 'music2d[pfa=1e-4]')
    """
    for place, sign in enumerate(text):
        if sign == "=" and text[:place].count("[") == text[:place].count("]"):
            return text[:place], text[place + 1 :]
    raise InputError(
        f"map {text!r}: allowed is OLD[param=value,...]=NEW[param=value,...], such as "
        "'music2d[pfa=1e-3]=music2d[pfa=1e-4]'"
    )


def find_variant(run: Run, text: str) -> Variant:
    """Find the one variant of a run that a specification fits.

    A variant fits if its name is the specification's and its stored parameters
    have every value that is given. A detector given by its name alone fits
    with any parameters. Of several that fit, the one with that label in tables is meant.
    """
    name, asked = parse_spec(text)
    variants = variants_in(run.rows)
    namesakes = [variant for variant in variants if variant[0] == name]
    if not namesakes:
        names = dict.fromkeys(estimator for estimator, _ in variants)
        raise InputError(f"{run.label}: no estimator fits {text!r}: {did_you_mean(name, names)}")
    fitting = [variant for variant in namesakes if _fits(json.loads(variant[1]), asked)]
    if not fitting:
        raise InputError(
            f"{run.label}: no variant fits {text!r}; allowed are {_variant_list(namesakes, asked)}"
        )
    labels = estimator_labels(namesakes)
    meant = fitting if len(fitting) == 1 else [variant for variant in namesakes if labels[variant] == text]
    if not meant:
        raise InputError(
            f"{run.label}: {text!r} fits {len(fitting)} variants, {_variant_list(fitting, asked)}; give a "
            "specification that fits one of them alone"
        )
    return meant[0]


def _fits(stored: Mapping[str, Any], asked: Mapping[str, Any]) -> bool:
    """Tell whether stored parameters have every value asked for."""
    return all(key in stored and _agrees(stored[key], value) for key, value in asked.items())


def _agrees(stored: Any, asked: Any) -> bool:
    """Compare a value in terms of JSON with one of a specification."""
    if isinstance(asked, Spec):
        return isinstance(stored, dict) and stored.get("name") == asked.name and _fits(stored, asked.params)
    if isinstance(asked, tuple):
        return isinstance(stored, list) and len(stored) == len(asked) and all(map(_agrees, stored, asked))
    if isinstance(asked, str):
        if isinstance(stored, dict):
            return bool(stored.get("name") == asked)
        return stored == asked or (stored is None and asked == "none")
    # In Python True == 1, in a specification it is not.
    return isinstance(stored, bool) == isinstance(asked, bool) and bool(stored == asked)


def _variant_list(variants: Sequence[Variant], asked: Collection[str]) -> str:
    """Spell the first few variants by the parameters that set them apart or were asked for."""
    more = f" and {len(variants) - MAX_LISTED} more" if len(variants) > MAX_LISTED else ""
    return ", ".join(spell_apart(variants, asked)[:MAX_LISTED]) + more


def spell_apart(variants: Sequence[Variant], also: Collection[str] = ()) -> list[str]:
    """Spell each variant by the parameters in which those of its name differ, and by those `also` named.

    Examples
    --------
    >>> spell_apart([("a", '{"k":0,"n":1}'), ("a", '{"k":0,"n":2}'), ("b", '{"n":1}')])
    ['a[n=1]', 'a[n=2]', 'b']
    """
    parsed = [(name, json.loads(params)) for name, params in variants]
    texts = []
    for name, params in parsed:
        namesakes = [other for other_name, other in parsed if other_name == name]
        differing = {key for key in params if any(other.get(key) != params[key] for other in namesakes)}
        shown = {key: value for key, value in params.items() if key in differing or key in also}
        texts.append(shortened(spell_spec(name, shown)))
    return texts


def find_pairs(base: Run, new: Run, maps: Iterable[str]) -> dict[Variant, Variant]:
    """Find the pairs of a variant of the base and one of the new run that maps stand for."""
    pairs: dict[Variant, Variant] = {}
    for old_text, new_text in map(parse_map, maps):
        old, partner = find_variant(base, old_text), find_variant(new, new_text)
        if old in pairs or partner in pairs.values():
            label, text = (base.label, old_text) if old in pairs else (new.label, new_text)
            raise InputError(f"{label}: {text!r} is paired twice; give one map for each variant")
        pairs[old] = partner
    return pairs


def pair_variants(base: Run, new: Run, partners: Mapping[Variant, Variant]) -> tuple[Run, Run, list[str]]:
    """Give rows of the new run the name and parameters of their partners in the base.

    All others are partners of their equals. Variants whose equal in the other run has another partner are
    left out, with a note.
    """
    olds, news = set(partners), set(partners.values())
    notes, sides = [], []
    for run, other, left_out in ((base, new, news - olds), (new, base, olds - news)):
        present = variants_in(run.rows)
        notes += [
            f"{spelt} of {run.label} is left out: that of {other.label} is paired with another"
            for variant, spelt in zip(present, spell_apart(present), strict=True)
            if variant in left_out
        ]
        sides.append(run.take(~is_of(run, left_out)))
    base, new = sides
    rows = new.rows.astype(dict.fromkeys(VARIANT, object))
    for variant, partner in partners.items():
        rows.loc[is_of(new, [partner]), VARIANT] = variant
    return base, new.changed(rows=rows), notes


def is_of(run: Run, variants: Collection[Variant]) -> NDArray[np.bool_]:
    """Mark the rows of some variants."""
    return pd.MultiIndex.from_frame(run.rows[VARIANT]).isin(list(variants))


def pair_cells(base: Run, new: Run, partners: Mapping[Variant, Variant]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Pair the cells of two runs by scenario, estimator, parameters, SNR and trial; list the others.

    `partners` are variants of the base, each with the variant of the new run that `pair_variants` has renamed
    to it. The pairs have a row for each cell that both runs scored: the columns of `CELL`, and all others
    twice, ending in ``_base`` and ``_new``. The second table is `Comparison.cells`.
    """
    # Categorical columns of two runs have different categories: merge them as text.
    text = dict.fromkeys([*CURVE, "status", "reason", "environment"], object)
    before, after = (run.rows.astype(text).copy() for run in (base, new))  # each in one piece
    cells = before.merge(after, on=CELL, how="outer", suffixes=("_base", "_new"), indicator=True)
    side = cells.pop("_merge")
    in_base, in_new = (cells[f"status_{end}"].isin(SCORED) for end in ("base", "new"))
    changes = {
        "missing": side == "left_only",
        "added": side == "right_only",
        "paired": in_base & in_new,
        "failed": in_base,
        "repaired": in_new,
    }
    change = pd.Series(np.select([*changes.values()], [*changes], "failed_both"), index=cells.index)
    is_of_base = change.isin(["missing", "repaired"])
    reasons = {
        name: cells[f"{name}_base"].where(is_of_base, cells[f"{name}_new"]) for name in ("status", "reason")
    }
    unpaired = cells[CELL].assign(change=change, **reasons)[change != "paired"]
    return cells[change == "paired"], with_partners(unpaired.reset_index(drop=True), partners)


def scored_pairs(pairs: pd.DataFrame, metric: str) -> pd.DataFrame:
    """Take the scores ``base`` and ``new`` of all pairs, with curve, SNR and trial."""
    sides = {end: pairs[f"{metric}_{end}"].astype(float) for end in ("base", "new")}
    return pairs[CELL].assign(**sides)


def with_partners(table: pd.DataFrame, partners: Mapping[Variant, Variant]) -> pd.DataFrame:
    """Append the columns ``new_estimator`` and ``new_params``, which differ where a variant has a partner."""
    variants = zip(table["estimator"], table["params"], strict=True)
    named = [partners.get(variant, variant) for variant in variants]
    return table.assign(new_estimator=[name for name, _ in named], new_params=[params for _, params in named])


def version_differences(base: Run, new: Run, partners: Mapping[Variant, Variant]) -> list[str]:
    """Say in one line, if at all, how the versions of the code differ for estimators that both runs have.

    Paired estimators with different names have different code in any case: its versions are left out.
    """
    before, after = _versions(base), _versions(new)
    differences: set[str] = set()
    for variant in before.keys() & after.keys():
        old, now = before[variant], after[variant]
        if partners.get(variant, variant)[0] != variant[0]:
            # Nor does the digest of what a plugin imports of isacbench count.
            old, now = (
                {**one, "plugins": {}, "isacbench": {"version": one.get("isacbench", {}).get("version")}}
                for one in (old, now)
            )
        if old != now:
            differences.update(differing_versions(now, old))
    return [f"made by other versions: {'; '.join(sorted(differences))}"] if differences else []


def _versions(run: Run) -> dict[Variant, dict[str, Any]]:
    """Versions that made the first cell of each estimator."""
    first = run.rows.drop_duplicates(VARIANT)[[*VARIANT, "environment"]]
    return {
        (estimator, params): run.environments[name].get("versions", {})
        for estimator, params, name in first.itertuples(index=False)
    }


def timed_alike(pairs: pd.DataFrame, metric: str, base: Run, new: Run) -> tuple[pd.DataFrame, list[str]]:
    """Select the pairs whose times can be compared, timed alone on equal machines; say what is left out."""
    timed = pairs["timing_base"].astype(bool) & pairs["timing_new"].astype(bool)
    before, after = (
        pairs[f"environment_{end}"].map(_machines(run)) for end, run in (("base", base), ("new", new))
    )
    other = timed & (before != after)
    reasons = []
    if not timed.all():
        reasons.append(f"{(~timed).sum()} were not timed (alone, serially, one BLAS thread) on both sides")
    if other.any():
        reasons.append(
            f"{other.sum()} ran on other machines ({before[other].iloc[0]}, and {after[other].iloc[0]})"
        )
    alike = pairs[timed & ~other]
    note = f"{metric}: {len(alike)} of {len(pairs)} paired cells compared; {', '.join(reasons)}"
    return alike, [note] if reasons else []


def _machines(run: Run) -> dict[str, str]:
    """Processor and number of cores of each environment, in words."""
    machines = {name: one["machine"] for name, one in run.environments.items()}
    return {name: f"{one['processor']}, {one['cores']} cores" for name, one in machines.items()}
