"""Labels of estimators: readable names, with the parameters that distinguish variants."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from typing import TYPE_CHECKING, Any

from isacbench.errors import InputError
from isacbench.plugins.discovery import PluginKind
from isacbench.plugins.registry import parameter_defaults, sees_truth
from isacbench.specifications import spell_spec

if TYPE_CHECKING:
    import pandas as pd

Variant = tuple[str, str]
"""Name and canonical parameters of an estimator."""

Params = Mapping[str, Any]
Known = Callable[[PluginKind, str], tuple[Params, Params] | None]

_NONE = object()


def variants_in(table: pd.DataFrame) -> list[Variant]:
    """List the estimators of a table.

    Parameters
    ----------
    table : DataFrame
        With the columns estimator and params.

    Returns
    -------
    list of (str, str)
        Names and canonical parameters, each pair once, in order.
    """
    return list(dict.fromkeys(zip(table["estimator"], table["params"], strict=True)))


def rows_of(table: pd.DataFrame, variant: Variant) -> pd.DataFrame:
    """Select the rows of one estimator.

    Parameters
    ----------
    table : DataFrame
        With the columns estimator and params.
    variant : (str, str)

    Returns
    -------
    DataFrame
    """
    return table[(table["estimator"] == variant[0]) & (table["params"] == variant[1])]


def find_limits(records: pd.DataFrame) -> set[str]:
    """Find the estimators of a run that see the truth.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.

    Returns
    -------
    set of str
        Their names. An estimator that is not installed counts as one that does not.
    """
    limits = set()
    for name in records["estimator"].unique():
        with suppress(InputError):  # a table can be made without the plugins that its rows are of
            limits |= {name} if sees_truth(name) else set()
    return limits


def variant_label(name: str, params: str) -> str:
    """Name an estimator, detector or receiver by itself: with the parameters that differ from the defaults.

    Parameters
    ----------
    name, params : str

    Returns
    -------
    str

    Examples
    --------
    >>> variant_label("oracle", '{"cell":0.5}'), variant_label("unknown", "{}")
    ('oracle[cell=0.5]', 'unknown')
    """
    own = json.loads(params)
    kinds: tuple[PluginKind, ...] = "estimator", "detector"
    unlike = next((found for kind in kinds if (found := _unlike_defaults(_defaults(kind, name), own))), {})
    return spell_spec(name, {key: _told(value, _defaults) for key, value in unlike.items()})


def estimator_labels(variants: Iterable[Variant]) -> dict[Variant, str]:
    """Name estimators for tables and figures: the bare name, with parameters where they are needed.

    A label shows the parameters that distinguish variants of one name, except
    values that more than half of them share. It also shows parameters that
    differ from their defaults, and a detector that could be mistaken for
    another one of the same name. The defaults of a plugin that is not installed
    are unknown: its parameters count as equal to them.

    Parameters
    ----------
    variants : iterable of (str, str)
        Names and canonical parameters, possibly repeated.

    Returns
    -------
    dict of (str, str) to str
        Labels; where the plugins are registered, they are also specifications
        of the same variants.

    Examples
    --------
    >>> labels = estimator_labels([("a", '{"n":1}'), ("b", '{"n":1}'), ("b", '{"n":2}')])
    >>> list(labels.values())
    ['a', 'b[n=1]', 'b[n=2]']
    """
    parsed = {(name, params): json.loads(params) for name, params in dict.fromkeys(variants)}
    namesakes: dict[str, list[Params]] = {}
    for (name, _), own in parsed.items():
        namesakes.setdefault(name, []).append(own)
    known = cache(_defaults)  # of a few plugins that many variants share
    return {
        (name, params): _label(name, own, namesakes[name], known) for (name, params), own in parsed.items()
    }


def _defaults(kind: PluginKind, name: str) -> tuple[Params, Params] | None:
    """Defaults of a plugin, and the values of missing parameters; None where they are unknown."""
    try:
        return parameter_defaults(kind, name)
    except InputError:  # not registered, or broken: its rows can be shown all the same
        return None


def _label(name: str, own: Params, namesakes: Sequence[Params], known: Known) -> str:
    unlike = _unlike_defaults(known("estimator", name), own) or {}
    told = {
        key: value
        for key, value in own.items()
        if key in unlike or _sets_apart(value, [other.get(key) for other in namesakes])
    }
    return spell_spec(name, {key: _told(value, known) for key, value in {**told, **unlike}.items()})


def _sets_apart(value: Any, values: Sequence[Any]) -> bool:
    """Tell whether at most half share a value, or a detector among them could be confused with it."""
    if 2 * values.count(value) <= len(values):
        return True
    names = [other.get("name") if isinstance(other, dict) else None for other in values]
    return isinstance(value, dict) and any(
        name == value["name"] and other != value for name, other in zip(names, values, strict=True)
    )


def _unlike_defaults(known: tuple[Params, Params] | None, own: Params) -> dict[str, Any] | None:
    """Parameters that differ from their defaults, None where the defaults are unknown."""
    if known is None:
        return None
    defaults, before = known
    # A missing field was added later; its value is the one that means the behaviour before.
    return {key: value for key, value in {**before, **own}.items() if value != defaults.get(key, _NONE)}


def _told(value: Any, known: Known) -> Any:
    """Value to show: of a detector only its name and the parameters that differ from known defaults."""
    if not isinstance(value, dict):
        return value
    own = {key: inner for key, inner in value.items() if key != "name"}
    unlike = _unlike_defaults(known("detector", value["name"]), own)
    return {"name": value["name"], **(own if unlike is None else unlike)}
