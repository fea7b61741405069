"""All families of cases, and the cases of the fixed table."""

from __future__ import annotations

from collections.abc import Sequence, Set
from typing import Any

from isacbench.checking.stress.case import Case
from isacbench.checking.stress.cases import crowds, levels, map_cases, places, radios
from isacbench.errors import InputError, unknown_name
from isacbench.plugins.discovery import PluginKind
from isacbench.specifications import parse_spec

FAMILIES: dict[str, type[Case[Any]]] = {
    family.name: family
    for module in (levels, crowds, places, radios, map_cases)
    for family in vars(module).values()
    if isinstance(family, type) and issubclass(family, Case) and family.__module__ == module.__name__
}
"""Families by name: all that the modules of cases define, in the order of the table."""


def table_of(kind: PluginKind) -> list[Case[Any]]:
    """Cases of the fixed table for one kind of plugin.

    Parameters
    ----------
    kind : {"estimator", "detector", "metric"}
    """
    return [case for family in find_families([], {kind}) for case in family.table()]


def find_cases(text: str) -> list[Case[Any]]:
    """Cases that a specification stands for.

    Parameters
    ----------
    text : str
        Name of a family for all of its cases in the table, or one case,
        ``name[param=value,...]``.

    Raises
    ------
    InputError
        If the family or a parameter is unknown, or a value outside its space.
    """
    spec = parse_spec(text)
    if spec.name not in FAMILIES:
        raise unknown_name("family of cases", spec.name, FAMILIES)
    family = FAMILIES[spec.name]
    return [family.of(spec)] if "[" in text else family.table()


def find_families(names: Sequence[str], kinds: Set[PluginKind]) -> list[type[Case[Any]]]:
    """Families by name.

    Parameters
    ----------
    names : sequence of str
        All families of those kinds where it is empty.
    kinds : set of {"estimator", "detector"}
        Kinds of plugins that they may be meant for.

    Raises
    ------
    InputError
        If a name is unknown, spells a case instead of a family, or stands for
        a family of another kind.
    """
    for name in names:
        if "[" in name:
            family = name.partition("[")[0]
            raise InputError(f"case {name!r}: a search draws from families; give {family}")
        find_cases(name)
        require_kind(name, FAMILIES[name], kinds)
    return [
        family for family in FAMILIES.values() if family.kind in kinds and (family.name in names or not names)
    ]


def require_kind(text: str, family: type[Case[Any]], kinds: Set[PluginKind]) -> None:
    """Refuse a case that is meant for none of the kinds.

    Parameters
    ----------
    text : str
        Specification of the case.
    kinds : set of {"estimator", "detector"}

    Raises
    ------
    InputError
        Saying what it is meant for.
    """
    if family.kind not in kinds:
        raise InputError(
            f"case {text!r} is a case for {family.kind}s, but only {' and '.join(kinds)}s were selected"
        )
