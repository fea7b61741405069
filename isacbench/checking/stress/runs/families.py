"""All families of cases, and the cases of the fixed table."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from isacbench.checking.stress.cases.blanks import Blank
from isacbench.checking.stress.cases.crowds import Close, Coherent, Crowd, Nothing, Pair, Spread
from isacbench.checking.stress.cases.digits import NextBeam, OpenedRange, Unseparated
from isacbench.checking.stress.cases.ladders import SnrLadder
from isacbench.checking.stress.cases.levels import Amplitude, DynamicRange, SinglePrecision, Snr
from isacbench.checking.stress.cases.map_cases import (
    BlankMap,
    ConstantMap,
    MapLevel,
    MapRange,
    MapWindow,
    Rate,
)
from isacbench.checking.stress.cases.places import Beyond, Bin, Direction, Fold
from isacbench.checking.stress.cases.radios import (
    ArrayShape,
    Chunks,
    DetectorWindow,
    FalseAlarms,
    Frames,
    Numerology,
    Subarray,
)
from isacbench.errors import InputError, unknown_name
from isacbench.plugins.specifications import parse_spec

if TYPE_CHECKING:
    from collections.abc import Sequence, Set

    from isacbench.checking.stress.case import Case
    from isacbench.plugins.discovery import PluginKind

FAMILIES: dict[str, type[Case[Any]]] = {
    family.name: family
    for family in (
        Snr,
        Amplitude,
        DynamicRange,
        Nothing,
        Pair,
        Close,
        Coherent,
        Spread,
        Crowd,
        OpenedRange,
        NextBeam,
        Unseparated,
        Bin,
        Direction,
        Fold,
        Beyond,
        Blank,
        ArrayShape,
        Subarray,
        Numerology,
        Frames,
        FalseAlarms,
        DetectorWindow,
        SinglePrecision,
        Chunks,
        SnrLadder,
        MapLevel,
        MapRange,
        ConstantMap,
        BlankMap,
        MapWindow,
        Rate,
    )
}
"""Families by name, in the order of the table."""


def families_of(kind: PluginKind) -> list[type[Case[Any]]]:
    """Families that are meant for estimators, or for detectors."""
    return [family for family in FAMILIES.values() if family.kind == kind]


def table_of(kind: PluginKind) -> list[Case[Any]]:
    """Cases of the fixed table that are meant for estimators, or for detectors."""
    return [case for family in families_of(kind) for case in family.table()]


def find_cases(text: str) -> list[Case[Any]]:
    """Cases that a specification stands for.

    Parameters
    ----------
    text : str
        Name of a family for all of its cases in the table, or one case,
        ``name[param=value,...]``.

    Returns
    -------
    list of Case

    Raises
    ------
    InputError
        If the family or a parameter is unknown, or a value outside its space.

    Examples
    --------
    >>> [case.spec for case in find_cases("frame")]
    ['frame[frame=paper]', 'frame[frame=turned_panel]']
    >>> find_cases("snr[snr_db=33]")[0].spec
    'snr[snr_db=33]'
    """
    spec = parse_spec(text)
    if spec.name not in FAMILIES:
        raise unknown_name("family of cases", spec.name, FAMILIES)
    family = FAMILIES[spec.name]
    return [family.of(spec)] if "[" in text else family.table()


def find_families(names: Sequence[str], kinds: Set[PluginKind]) -> list[type[Case[Any]]]:
    """Families by name, all where there are no names.

    Parameters
    ----------
    names : sequence of str
    kinds : set of {"estimator", "detector"}
        What they may be meant for.

    Raises
    ------
    InputError
        If one is unknown, a case where a family is meant, or meant for
        something else.
    """
    for name in names:
        if "[" in name:
            raise InputError(
                f"case {name!r}: a search draws from families; allowed is {name.partition('[')[0]}"
            )
        if name not in FAMILIES:
            raise unknown_name("family of cases", name, FAMILIES)
        require_kind(name, FAMILIES[name], kinds)
    return [FAMILIES[name] for name in names] or [
        family for family in FAMILIES.values() if family.kind in kinds
    ]


def require_kind(text: str, family: type[Case[Any]], kinds: Set[PluginKind]) -> None:
    """Refuse a case that is meant for none of the kinds.

    Raises
    ------
    InputError
        Saying what it is meant for.
    """
    if family.kind not in kinds:
        raise InputError(f"case {text!r} is meant for {family.kind}s; asked for are {' and '.join(kinds)}s")
