"""Labels of estimators: names for people, with the parameters that have to be told."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from typing import Any

from isacbench.errors import InputError
from isacbench.plugins.discovery import PluginKind
from isacbench.plugins.registry import parameter_defaults
from isacbench.plugins.specifications import spell_spec, spell_value

Variant = tuple[str, str]
"""Name and canonical parameters of an estimator."""

Params = Mapping[str, Any]

Defaults = tuple[dict[str, Any], dict[str, Any]]
Known = Callable[[PluginKind, str], Defaults | None]


def estimator_labels(variants: Iterable[Variant]) -> dict[Variant, str]:
    """Name estimators for people: the bare name, or with the parameters that have to be told.

    These are the parameters that set variants of one name apart, but for
    values that more than half of them share; those that are not as by default;
    and a detector that can be mistaken for another one of the same name. What
    is by default is known of estimators that are registered.

    Parameters
    ----------
    variants : iterable of (str, str)
        Names and canonical parameters, possibly repeated.

    Returns
    -------
    dict of (str, str) to str
        As specifications that mean the same variants, where they are
        registered.

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
    # What is installed is listed anew whenever it is asked for, which takes milliseconds.
    known = cache(_defaults)
    return {
        (name, params): _label(name, own, namesakes[name], known) for (name, params), own in parsed.items()
    }


def _defaults(kind: PluginKind, name: str) -> Defaults | None:
    """Defaults of a plugin, and what parameters meant that are missing; None where nobody knows them."""
    try:
        return parameter_defaults(kind, name)
    except InputError:  # not registered, or broken: its rows can be shown all the same
        return None


def _label(name: str, own: Params, namesakes: Sequence[Params], known: Known) -> str:
    unlike = _unlike_defaults(known("estimator", name), own)
    if unlike is None:
        return name + _differing(own, namesakes)
    told = {
        key: value
        for key, value in own.items()
        if key in unlike or _sets_apart(value, [other.get(key) for other in namesakes])
    }
    return spell_spec(name, {key: _told(value, known) for key, value in {**told, **unlike}.items()})


def _sets_apart(value: Any, values: Sequence[Any]) -> bool:
    """Tell whether at most half share a value, or a detector among them could be mistaken for it."""
    if 2 * values.count(value) <= len(values):
        return True
    return _is_plugin(value) and any(other != value for other in values if _name(other) == _name(value))


def _unlike_defaults(known: Defaults | None, own: Params) -> dict[str, Any] | None:
    """Parameters that are not as by default, None where nobody knows the defaults."""
    if known is None:
        return None
    defaults, before = known
    # A field that is missing was added later, and has the value that stands for what was before.
    return {key: value for key, value in {**before, **own}.items() if value != defaults.get(key, _NONE)}


_NONE = object()


def _is_plugin(value: Any) -> bool:
    return isinstance(value, dict) and "name" in value


def _name(value: Any) -> Any:
    return value["name"] if _is_plugin(value) else None


def _told(value: Any, known: Known) -> Any:
    """Value with what has to be told of a detector: what is not as by default, all where it is not known."""
    if not _is_plugin(value):
        return value
    own = {key: inner for key, inner in value.items() if key != "name"}
    unlike = _unlike_defaults(known("detector", value["name"]), own)
    return {"name": value["name"], **(own if unlike is None else unlike)}


def _differing(own: Params, others: Sequence[Any]) -> str:
    """Parameters that set these apart from most others, as a specification writes them."""
    texts = []
    for key, value in own.items():
        values = [other.get(key) for other in others]
        if key == "name" or 2 * values.count(value) > len(values):
            continue
        if _is_plugin(value):
            namesakes = [other for other in values if _is_plugin(other) and other["name"] == value["name"]]
            texts.append(f"{key}={value['name']}{_differing(value, namesakes)}")
        else:
            texts.append(f"{key}={spell_value(value)}")
    return f"[{','.join(texts)}]" if texts else ""
