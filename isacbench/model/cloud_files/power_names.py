"""Names under which other programs store the power of points."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from isacbench.errors import InputError
from isacbench.files.escaping import shortened

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

_LIKE_POWER = re.compile(
    "pow|pwr|amplitude|intensity|magnitude|strength|reflect|gain|section|energy|level|rcs|snr|rssi"
    "|(?<![a-z])(ampl?s?|mags?|p|sigma|dbs?m?)(?![a-z])",
    re.IGNORECASE,
)


def require_no_power(path: Path, names: Iterable[str]) -> None:
    """Refuse what may be the power, where nothing is named so and all points would get power 1.

    Parameters
    ----------
    path : Path
        File to name in messages.
    names : iterable of str
        Of what a cloud without ``power`` has for each point.

    Raises
    ------
    InputError
        Naming all that may be the power.
    """
    found = ", ".join(filter(_LIKE_POWER.search, names))
    if found:
        raise InputError(
            f"{path}: has no power, but {shortened(found)}; allowed is the name power for powers relative "
            "to a unit scatterer, or nothing like it for points of power 1"
        )
