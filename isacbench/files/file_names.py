"""Names of files made from names of scenarios, scores and estimators."""

from __future__ import annotations

import re
from collections.abc import Iterable

MAX_STEM = 60


def file_stems(names: Iterable[str]) -> dict[str, str]:
    """Give every name a part of a file name that is safe and unique on every system.

    Examples
    --------
    >>> file_stems(["street", "../a b", "Street"])
    {'street': 'street', '../a b': 'a-b', 'Street': 'Street-2'}
    """
    stems: dict[str, str] = {}
    taken: set[str] = set()
    for name in names:
        base = re.sub(r"[^A-Za-z0-9_]+", "-", name)[:MAX_STEM].strip("-") or "unnamed"
        stem, number = base, 1
        while stem.lower() in taken:
            number += 1
            stem = f"{base}-{number}"
        taken.add(stem.lower())
        stems[name] = stem
    return stems
