"""Names of the columns of points, as other programs spell them."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from isacbench.errors import InputError
from isacbench.files.escaping import quoted, shortened
from isacbench.model.cloud_files.power_names import require_no_other_names

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

POINT_COLUMNS = ["x", "y", "z", "v", "power"]
"""Columns of a cloud in tables and csv files: positions in m, radial velocity in m/s, power."""

_BESIDE_OTHER_V = re.compile(r"(.*[_ ])?(t?u|s)", re.IGNORECASE)
"""Names of a texture or a colour, whose v is no velocity."""


def plain_name(name: str) -> str:
    """Spell the name of a column as isacbench does.

    Parameters
    ----------
    name : str

    Returns
    -------
    str

    Examples
    --------
    >>> [plain_name(name) for name in ("X", "velocity", "scalar_v")]
    ['x', 'v', 'v']
    """
    plain = name.strip().lower().removeprefix("scalar_")  # which CloudCompare puts before its scalar fields
    return "v" if plain == "velocity" else plain


def find_columns(path: Path, place: str, names: Sequence[str]) -> dict[str, int]:
    """Find the columns of a cloud among others.

    Parameters
    ----------
    path : Path
        File to name in messages.
    place : str
        Where it has these names.
    names : sequence of str

    Returns
    -------
    dict of str to int
        Indices of x, y, z and, if there, v and power, in this order.

    Raises
    ------
    InputError
        If x, y or z is missing, two columns may be the same, a v is of a
        texture, or another name may be that of the velocity or power.
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
        path, found, [name for index, name in enumerate(names) if plain[index] not in found]
    )
    return found
