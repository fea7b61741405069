"""Names under which other programs store the power and the velocity of points."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from isacbench.errors import InputError
from isacbench.files.escaping import shortened

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from pathlib import Path

_LIKE_POWER = re.compile(
    "pow|pwr|amplitude|intensity|magnitude|strength|reflect|gain|section|energy|level|rcs|snr|rssi"
    "|(?<![a-z])(ampl?s?|mags?|p|sigma|dbs?m?)(?![a-z])",
    re.IGNORECASE,
)

_LIKE_VELOCITY = re.compile(
    "velocity|(?<![a-z])vel|doppler|speed|range.?rate|(?<![a-z])vr(?![a-z])|^v([^a-z]|$)", re.IGNORECASE
)

_PANDAS_INDEX = re.compile(r"level_\d+|__index_level_\d+__")
"""Names that pandas gives to numbers of rows."""

_ALIKE = {
    "v": (
        _LIKE_VELOCITY,
        "velocity",
        "the name velocity for m/s, positive when approaching, or nothing like it for unknown velocities",
    ),
    "power": (
        _LIKE_POWER,
        "power",
        "the name power for powers relative to a unit scatterer, or nothing like it for points of power 1",
    ),
}


def require_no_other_names(path: Path, columns: Collection[str], others: Sequence[str]) -> None:
    """Refuse what may be velocity or power, where nothing is named so and all points would get none or 1.

    Parameters
    ----------
    path : Path
        File to name in messages.
    columns : collection of str
        Columns of the cloud.
    others : sequence of str
        Names of what else the file has for each point.

    Raises
    ------
    InputError
        Naming all that may be the velocity or the power.
    """
    for column, (like, name, allowed) in _ALIKE.items():
        found = ", ".join(name for name in others if like.search(name) and not _PANDAS_INDEX.fullmatch(name))
        if column not in columns and found:
            raise InputError(f"{path}: has no {name}, but {shortened(found)}; allowed is {allowed}")
