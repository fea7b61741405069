"""Labels of estimators: readable names, with the parameters that distinguish variants."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import pandas as pd

from isacbench.charts import Variant
from isacbench.errors import InputError
from isacbench.plugins.discovery import PluginKind
from isacbench.plugins.registry import parameter_defaults, sees_truth
from isacbench.specifications import spell_spec

Params = Mapping[str, Any]


def references_in(records: pd.DataFrame) -> set[str]:
    """Find the estimators of a run that see the truth, by name; not those that are not installed."""
    limits = set()
    for name in records["estimator"].unique():
        with suppress(InputError):  # a table can be made without the plugins that its rows are of
            limits |= {name} if sees_truth(name) else set()
    return limits


def variant_label(name: str, params: str) -> str:
    """Name an estimator, detector or receiver by itself: with the parameters that differ from the defaults.

    Examples
    --------
    >>> variant_label("oracle", '{"cell":0.5}'), variant_label("unknown", "{}")
    ('oracle[cell=0.5]', 'unknown')
    """
    own = json.loads(params)
    kinds: tuple[PluginKind, ...] = "estimator", "detector"
    unlike = next((found for kind in kinds if (found := _unlike_defaults(kind, name, own))), {})
    return spell_spec(name, {key: _short_value(value) for key, value in unlike.items()})


def estimator_labels(variants: Iterable[Variant]) -> dict[Variant, str]:
    """Name estimators for tables and figures: the bare name, with parameters that differ from the defaults.

    Of plugins that are not installed the defaults are unknown: variants of one name show what they differ in.
    `variants` may repeat. Where the plugins are registered, labels are specifications of the same variants.

    Examples
    --------
    >>> labels = estimator_labels([("a", '{"n":1}'), ("b", '{"n":1}'), ("b", '{"n":2}')])
    >>> list(labels.values())
    ['a', 'b[n=1]', 'b[n=2]']
    """
    labels = {variant: variant_label(*variant) for variant in dict.fromkeys(variants)}
    namesakes: dict[str, list[Variant]] = {}
    for variant, label in labels.items():
        namesakes.setdefault(label, []).append(variant)
    for same in namesakes.values():
        if len(same) > 1:
            labels |= _with_differences(same)
    return labels


def _with_differences(variants: Sequence[Variant]) -> dict[Variant, str]:
    """Labels of variants of one name with the parameters in which they differ."""
    parsed = [json.loads(params) for _, params in variants]
    keys = dict.fromkeys(key for own in parsed for key in own)
    differing = [key for key in keys if any(own.get(key) != parsed[0].get(key) for own in parsed)]
    return {
        variant: spell_spec(variant[0], {key: _short_value(own[key]) for key in differing if key in own})
        for variant, own in zip(variants, parsed, strict=True)
    }


def _unlike_defaults(kind: PluginKind, name: str, own: Params) -> dict[str, Any] | None:
    """Parameters that differ from their defaults, None where the defaults are unknown."""
    try:
        defaults = parameter_defaults(kind, name)
    except InputError:  # not registered, or broken: its rows can be shown all the same
        return None
    return {key: value for key, value in own.items() if key not in defaults or value != defaults[key]}


def _short_value(value: Any) -> Any:
    """Value to show: of a detector only its name and the parameters that differ from known defaults."""
    if not isinstance(value, dict):
        return value
    own = {key: inner for key, inner in value.items() if key != "name"}
    unlike = _unlike_defaults("detector", value["name"], own)
    return {"name": value["name"], **(own if unlike is None else unlike)}
