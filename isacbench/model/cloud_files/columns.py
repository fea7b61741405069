"""Names of the columns of points, as other programs spell them."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from pathlib import Path

from isacbench.errors import InputError
from isacbench.files.escaping import quoted, shortened

POINT_COLUMNS = ["x", "y", "z", "v", "power"]
"""Columns of a cloud in tables and csv files: positions in m, radial velocity in m/s, power."""

_BESIDE_OTHER_V = re.compile(r"(.*[_ ])?(t?u|s)", re.IGNORECASE)
"""Names of a texture or a colour, whose v is no velocity."""

_PANDAS_INDEX = re.compile(r"level_\d+|__index_level_\d+__")
"""Names that pandas gives to numbers of rows."""

_ALIKE = {
    "v": (
        "velocity|(?<![a-z])vel|doppler|speed|range.?rate|(?<![a-z])vr(?![a-z])|^v([^a-z]|$)",
        "velocity",
        "the name velocity for m/s, positive when approaching, or nothing like it for unknown velocities",
    ),
    "power": (
        "pow|pwr|amplitude|intensity|magnitude|strength|reflect|gain|section|energy|level|rcs|snr|rssi"
        "|(?<![a-z])(ampl?s?|mags?|p|sigma|dbs?m?)(?![a-z])",
        "power",
        "the name power for powers relative to a unit scatterer, or nothing like it for points of power 1",
    ),
}
"""Names under which other programs store a column, what it is called, and what is allowed."""


def plain_name(name: str) -> str:
    """Spell the name of a column as isacbench does.

    Examples
    --------
    >>> [plain_name(name) for name in ("X", "velocity", "scalar_v")]
    ['x', 'v', 'v']
    """
    plain = name.strip().lower().removeprefix("scalar_")  # which CloudCompare puts before its scalar fields
    return "v" if plain == "velocity" else plain


def names_points(names: Sequence[str]) -> bool:
    """Tell if x, y and z are among some names."""
    return {"x", "y", "z"} <= {plain_name(name) for name in names}


def find_columns(path: Path, place: str, names: Sequence[str]) -> dict[str, int]:
    """Find the columns of a cloud among the names that a file has at a place.

    Returns the indices of x, y, z and, if there, v and power, in this order.
    Refuses two columns that may be the same, a v of a texture, and another
    name that may be that of the velocity or the power.
    """
    plain = [plain_name(name) for name in names]
    texture = next(filter(_BESIDE_OTHER_V.fullmatch, names), None)
    faults = [f"{quoted(name)} has control characters" for name in names if not name.isprintable()]
    faults += [f"{name} is missing" for name in "xyz" if name not in plain]
    if texture and "v" in plain:
        plain = ["" if name.strip().lower() == "v" else one for name, one in zip(names, plain, strict=True)]
        faults += [] if "v" in plain else [f"v beside {texture} is of a texture"]
    for name in POINT_COLUMNS:
        same = [one for one, spelled in zip(names, plain, strict=True) if spelled == name]
        faults += [f"{name} appears twice, as {' and '.join(same)}"] if len(same) > 1 else []
    if faults:
        raise InputError(
            f"{path}: {place}: {faults[0]}; a cloud takes x, y, z and, if there, v (or velocity) and power; "
            f"it has {shortened(', '.join(names)) or 'none'}"
        )
    found = {name: plain.index(name) for name in POINT_COLUMNS if name in plain}
    require_no_other_names(
        path, found, [name for name, one in zip(names, plain, strict=True) if one not in found]
    )
    return found


def require_no_other_names(path: Path, columns: Collection[str], others: Sequence[str]) -> None:
    """Refuse what may be velocity or power, where no column is named so: all points would get none or 1."""
    for column, (like, name, allowed) in _ALIKE.items():
        alike = re.compile(like, re.IGNORECASE)
        found = ", ".join(one for one in others if alike.search(one) and not _PANDAS_INDEX.fullmatch(one))
        if column not in columns and found:
            raise InputError(f"{path}: has no {name}, but {shortened(found)}; allowed is {allowed}")
