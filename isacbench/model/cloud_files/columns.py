"""Names of the columns of points, as other programs spell them."""

import re
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from isacbench.checked_arrays import Floats
from isacbench.errors import InputError
from isacbench.files.escaping import shortened

POINT_COLUMNS = ["x", "y", "z", "v", "power"]
"""Columns of a cloud in tables and csv files: positions in m, radial velocity in m/s, power."""

_BESIDE_OTHER_V = re.compile(r"(.*[_ ])?(t?u|s)", re.IGNORECASE)
"""Names of a texture or a colour, whose v is no velocity."""

_ALIKE = {
    "v": (
        "velocity|(?<![a-z])vel|doppler|speed|range.?rate|(?<![a-z])vr(?![a-z])|^v([^a-z]|$)",
        "velocity",
        "the name velocity for m/s, positive when approaching, or nothing like it for unknown velocities",
    ),
    "power": (
        "pow|pwr|amplitude|intensity|magnitude|strength|reflect|gain|section|energy|rcs|snr|rssi"
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


def find_columns(path: Path, place: str, names: Sequence[str]) -> dict[str, int]:
    """Find the columns of a cloud among the names that a file has at a place.

    Returns the indices of x, y, z and, if there, v and power, in this order.
    Refuses two columns that may be the same, a v of a texture, and another
    name that may be that of the velocity or the power.
    """
    plain = [plain_name(name) for name in names]
    texture = next(filter(_BESIDE_OTHER_V.fullmatch, names), None)
    faults = [f"{name} is missing" for name in "xyz" if name not in plain]
    faults += [f"{name} appears twice" for name in POINT_COLUMNS if plain.count(name) > 1]
    if texture and any(name.strip().lower() == "v" for name in names):
        faults.append(f"v beside {texture} is of a texture")
    if faults:
        raise InputError(
            f"{path}: {place}: {faults[0]}; a cloud takes x, y, z and, if there, v (or velocity) and power; "
            f"it has {shortened(', '.join(names)) or 'none'}"
        )
    found = {name: plain.index(name) for name in POINT_COLUMNS if name in plain}
    others = [name for name, spelled in zip(names, plain, strict=True) if spelled not in found]
    require_no_other_names(path, found, others)
    return found


def require_no_other_names(path: Path, columns: Collection[str], others: Sequence[str]) -> None:
    """Refuse what may be velocity or power, where no column is named so: all points would get none or 1."""
    for column, (like, name, allowed) in _ALIKE.items():
        found = ", ".join(filter(re.compile(like, re.IGNORECASE).search, others))
        if column not in columns and found:
            raise InputError(f"{path}: has no {name}, but {shortened(found)}; allowed is {allowed}")


def require_finite(path: Path, values: Floats, columns: Sequence[str], row_numbers: Sequence[int]) -> None:
    """Refuse an array (n, len(columns)) that holds NaN or infinity, naming row and column of the first."""
    faults = np.argwhere(~np.isfinite(values))
    if faults.size:
        row, column = faults[0]
        raise InputError(
            f"{path}: row {row_numbers[row]}: column {columns[column]} is {values[row, column]}; "
            "expected a finite number"
        )
