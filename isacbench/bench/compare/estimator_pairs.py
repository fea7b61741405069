"""Pairs of estimators to compare, found in the runs that hold them; their plugins need not be installed."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pandas as pd

from isacbench.bench.plan.labels import estimator_labels
from isacbench.charts import Variant
from isacbench.errors import InputError, did_you_mean
from isacbench.files.escaping import shortened
from isacbench.specifications import Spec, parse_spec, spell_spec

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from isacbench.bench.store.run import Run

MAX_LISTED = 10
"""Variants that a message lists."""

KEYS = ["estimator", "params"]


def parse_map(text: str) -> tuple[str, str]:
    """Cut ``OLD[param=value,...]=NEW[param=value,...]`` into its two specifications.

    Raises
    ------
    InputError
        Quoting the text and saying what is allowed.

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


def variants_of(run: Run) -> list[Variant]:
    """List the variants of estimators that a run holds, in the order of its rows."""
    return list(run.rows[KEYS].drop_duplicates().itertuples(index=False, name=None))


def find_variant(run: Run, text: str) -> Variant:
    """Find the one variant of a run that a specification fits.

    A variant fits if its name is the specification's and its stored parameters
    have every value that is given. A detector given by its name alone fits
    with any parameters. Of several that fit, the one with that label in tables is meant.
    """
    name, asked = parse_spec(text)
    variants = variants_of(run)
    namesakes = [variant for variant in variants if variant[0] == name]
    if not namesakes:
        names = dict.fromkeys(estimator for estimator, _ in variants)
        raise InputError(f"{run.label}: no estimator fits {text!r}: {did_you_mean(name, names)}")
    stored = [json.loads(params) for _, params in namesakes]
    fitting = [index for index, params in enumerate(stored) if _fits(params, asked)]
    if len(fitting) == 1:
        return namesakes[fitting[0]]
    if not fitting:
        raise InputError(f"{run.label}: no variant fits {text!r}; allowed are {_listed(namesakes, asked)}")
    labels = estimator_labels(namesakes)
    for variant in namesakes:
        if labels[variant] == text:
            return variant
    several = _listed([namesakes[index] for index in fitting], asked)
    raise InputError(
        f"{run.label}: {text!r} fits {len(fitting)} variants, {several}; give a specification that fits one "
        "of them alone"
    )


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


def restrict(run: Run, variant: Variant) -> Run:
    """Take the rows of one variant."""
    return run.take(_is_of(run.rows, [variant]))


def pair_variants(base: Run, new: Run, partners: Mapping[Variant, Variant]) -> tuple[Run, Run, list[str]]:
    """Give rows of the new run the name and parameters of their partners in the base.

    All others are partners of their equals. Variants whose equal in the other run has another partner are
    left out, with a note.
    """
    news = set(partners.values())
    left_base, notes = _without(base, news - set(partners), new.label)
    left_new, more = _without(new, set(partners) - news, base.label)
    rows = left_new.rows.astype(dict.fromkeys(KEYS, object))
    for variant, partner in partners.items():
        rows.loc[_is_of(left_new.rows, [partner]), KEYS] = variant
    return left_base, left_new.changed(rows=rows), notes + more


def spell_apart(variants: Sequence[Variant], also: Collection[str] = ()) -> list[str]:
    """Spell each variant by the parameters in which those of its name differ.

    Parameters
    ----------
    also : collection of str
        Parameters to spell in any case.

    Examples
    --------
    >>> spell_apart([("a", '{"k":0,"n":1}'), ("a", '{"k":0,"n":2}'), ("b", '{"n":1}')])
    ['a[n=1]', 'a[n=2]', 'b']
    """
    parsed = [(name, json.loads(params)) for name, params in variants]
    texts = []
    for name, params in parsed:
        others = [other for other_name, other in parsed if other_name == name]
        shown = {
            key: value
            for key, value in params.items()
            if key in also or any(other.get(key) != value for other in others)
        }
        texts.append(shortened(spell_spec(name, shown)))
    return texts


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


def _listed(variants: Sequence[Variant], asked: Collection[str]) -> str:
    """Spell the first few variants by the parameters that set them apart or were asked for."""
    more = f" and {len(variants) - MAX_LISTED} more" if len(variants) > MAX_LISTED else ""
    return f"{', '.join(spell_apart(variants, asked)[:MAX_LISTED])}{more}"


def _is_of(rows: pd.DataFrame, variants: Collection[Variant]) -> NDArray[np.bool_]:
    """Mark the rows of some variants."""
    return pd.MultiIndex.from_frame(rows[KEYS]).isin(list(variants))


def _without(run: Run, variants: Collection[Variant], other: str) -> tuple[Run, list[str]]:
    """Leave variants out as far as a run holds them, and say so."""
    present = variants_of(run)
    notes = [
        f"{spelt} of {run.label} is left out: that of {other} is paired with another"
        for variant, spelt in zip(present, spell_apart(present), strict=True)
        if variant in variants
    ]
    return run.take(~_is_of(run.rows, variants)), notes
