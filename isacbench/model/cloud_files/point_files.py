"""Point clouds in files: csv, npy, npz, mat and ply, recognised by their extension."""

from collections.abc import Callable, Mapping
from math import prod
from pathlib import Path
from typing import Any, NamedTuple, TypeGuard

import numpy as np

from isacbench.checked_arrays import Floats
from isacbench.errors import InputError
from isacbench.files.arrays import TEXTS, Entries, StoredArray, names_of, open_arrays
from isacbench.files.checked_files import (
    CLOUD_BYTES,
    binary_size,
    known_suffix,
    require_file,
    require_replaceable,
    write_errors,
)
from isacbench.files.escaping import shortened
from isacbench.model.cloud_files.ply import read_ply, write_ply
from isacbench.model.cloud_files.tables import (
    NO_ROW_NUMBERS,
    POINT_COLUMNS,
    find_columns,
    plain_name,
    read_csv_table,
    require_finite,
    require_no_other_names,
)

TAKES = "a cloud takes"

_SCATTERER = (*POINT_COLUMNS[:-1], "amplitude")
_OBJECT = "object"


class Points(NamedTuple):
    """Scatterers as a scenario's points file lists them.

    Attributes
    ----------
    xyz : ndarray of float64, shape (n, 3)
        Positions in metres.
    velocity : ndarray of float64, shape (n,)
        Radial velocities in m/s, positive when approaching.
    amplitude : ndarray of float64, shape (n,)
        Echo amplitudes |G|, 1 where the file has none.
    objects : tuple of str, length n or 0
        Object of each scatterer, where the file has a column for them.
    """

    xyz: Floats
    velocity: Floats
    amplitude: Floats
    objects: tuple[str, ...] = ()


def read_point_table(path: str | Path) -> dict[str, Floats]:
    r"""Read the points of a cloud; `isacbench.model.cloud.PointCloud.read` makes a cloud of them.

    Parameters
    ----------
    path : str or Path
        File in one of these formats, recognised by the extension:

        - csv: header ``x,y,z,v,power`` in any order, v (or velocity) and power
          optional, other columns ignored; or no header and 3 to 5 columns in
          that order. Separators are commas, semicolons, tabs or blanks;
        - npy: an array of shape (n, 3), (n, 4) or (n, 5);
        - npz and mat (MATLAB's -v4 to -v7.3): arrays ``xyz`` (n, 3) and
          optionally ``velocity`` (n,) and ``power`` (n,), or exactly one array
          of shape (n, 4) or (n, 5), or else (n, 3), under any name, and none larger;
        - ply: element vertex with x, y, z, optionally v (or velocity) and power.

        Nothing is ever unpickled.

    Returns
    -------
    dict of str to ndarray of float64, shape (n,)
        Columns x, y, z in m and, where the file has them, v in m/s and power; n may be 0.

    Raises
    ------
    InputError
        If the file is missing, damaged, of another kind or larger than 256
        MiB, or holds a value that is not finite; the message names the file
        and the place.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "cloud.csv"
    >>> _ = path.write_text("x,y,z,v\n1,2,3,4\n")
    >>> {name: column.tolist() for name, column in read_point_table(path).items()}
    {'x': [1.0], 'y': [2.0], 'z': [3.0], 'v': [4.0]}
    """
    path = Path(path)
    suffix = known_suffix(path, _READERS, TAKES)
    require_file(path, CLOUD_BYTES)
    return _READERS[suffix](path)


def require_writable(path: Path) -> None:
    """Refuse a file that `write_point_table` could not write; call it before the work."""
    known_suffix(path, _WRITERS, TAKES)
    require_replaceable(path)


def write_point_table(points: Mapping[str, Floats], path: str | Path) -> None:
    """Write the points of a cloud, so that reading them returns the same doubles.

    The columns are those that `read_point_table` returns; the extension decides the format. A file is
    overwritten.
    """
    path = Path(path)
    write = _WRITERS[known_suffix(path, _WRITERS, TAKES)]
    with write_errors(path):
        write(points, path)


def read_points_csv(path: str | Path) -> Points:
    """Read the scatterers of a scenario: header ``x,y,z,v``, optionally ``amplitude`` and ``object``.

    The csv file is spelled as those of clouds may be, without other columns. It has one row at least.
    """
    path = Path(path)
    table = read_csv_table(path)
    plain = [plain_name(name) for name in table.names if name]
    known = (*_SCATTERER, _OBJECT)
    if not {*_SCATTERER[:-1]} <= {*plain} <= {*known} or len({*plain}) < len(plain):
        raise InputError(
            f"{path}: {table.place}: takes the columns x, y, z, v and optionally amplitude and object, "
            f"not {shortened(', '.join(filter(None, table.names))) or 'rows without a header'}"
        )
    if not table.rows:
        raise InputError(f"{path}: holds no points below its header")
    place_of = {plain_name(name): place for place, name in enumerate(table.names)}
    values = table.values(table.names, [place_of[name] for name in _SCATTERER if name in place_of])
    amplitude = values[:, 4] if "amplitude" in place_of else np.ones(len(values))
    objects = [row[place_of[_OBJECT]].strip() for row in table.rows] if _OBJECT in place_of else ()
    return Points(values[:, :3], values[:, 3], amplitude, tuple(objects))


def _read_csv(path: Path) -> dict[str, Floats]:
    table = read_csv_table(path)
    if table.names:
        places = find_columns(path, table.place, table.names)
        return dict(zip(places, table.values(table.names, [*places.values()]).T, strict=True))
    first = table.rows[0]
    if len(first) not in (3, 4, 5):
        raise InputError(
            f"{path}: {table.place}: {len(first)} fields; without a header a cloud takes 3, 4 or 5 "
            f"({', '.join(POINT_COLUMNS)}), in {NO_ROW_NUMBERS}"
        )
    columns = POINT_COLUMNS[: len(first)]
    values = table.values(columns, range(len(first)))
    numbers_columns = first == [str(column) for column in range(len(first))]
    is_whole = (values % 1 == 0).all(axis=0)
    are_distinct = 1 < len(values) == len(np.unique(values[:, 0]))
    if numbers_columns or (len(first) > 3 and is_whole[0] and not is_whole.all() and are_distinct):
        raise InputError(
            f"{path}: {table.place}: may number the columns or the rows; allowed is a header x, y, z ... and "
            f"{NO_ROW_NUMBERS}"
        )
    return dict(zip(columns, values.T, strict=True))


def _write_csv(points: Mapping[str, Floats], path: Path) -> None:
    import pandas as pd

    with path.open("w", encoding="ascii", newline="") as file:  # pandas has words of its own for a refusal
        pd.DataFrame(points).to_csv(file, index=False, lineterminator="\n")


def _read_arrays(path: Path) -> dict[str, Floats]:
    """Read a file of arrays: xyz, velocity and power, or the only table among them."""
    with open_arrays(path) as (entries, _):
        chosen = _chosen_arrays(path, entries)
        if sum(array.n_bytes for array in chosen.values()) > CLOUD_BYTES:
            raise InputError(
                f"{path}: its arrays take more than the {binary_size(CLOUD_BYTES)} that are allowed"
            )
        first, *others = [array.whole() for array in chosen.values()]
        values = np.column_stack([first, *(other.ravel() for other in others)]).astype(np.float64, copy=False)
        columns = POINT_COLUMNS[: values.shape[1]]
        if "xyz" in chosen:  # and no table has this name
            columns = [*"xyz", *(plain_name(name) for name in [*chosen][1:])]
        beside = [
            name
            for name, array in entries.items()
            if name not in chosen and _may_be_of_points(array, len(values))
        ]
        require_no_other_names(path, columns, beside)
    require_finite(path, values, columns, range(1, len(values) + 1))
    return dict(zip(columns, values.T, strict=True))


def _chosen_arrays(path: Path, arrays: Entries) -> dict[str, StoredArray]:
    """Find the arrays that make a cloud: the table, or xyz and, if there, velocity and power."""
    if "xyz" in arrays or "velocity" in arrays:
        return _parts(path, arrays)
    numbers = {name: array for name, array in arrays.items() if _is_real(array)}
    outer = {name: array for name, array in numbers.items() if "/" not in name} or numbers
    tables: dict[str, StoredArray] = {}
    for n_columns in ((4, 5), (3,)):
        # A matrix of 3 x 3 turns points; without a name it is all that a file has.
        tables = tables or {
            name: array
            for name, array in outer.items()
            if len(array.shape) == 2 and array.shape[1] in n_columns and (array.shape != (3, 3) or not name)
        }
    table = next(iter(tables.values())) if len(tables) == 1 else None
    rivals = {  # such as the points beside the pose of a sensor
        name: array
        for name, array in numbers.items()
        if table is None
        or prod(array.shape) > prod(table.shape)
        or (array.shape[1:] in ((3,), (4,), (5,)) and array.shape[0] > table.shape[0])
    }
    if table is None or rivals:
        held = names_of({**tables, **rivals} if tables else arrays) or "nothing"
        raise InputError(
            f"{path}: takes real numbers: xyz (n, 3), optionally velocity (n) and power (n), or exactly one "
            f"array of shape (n, 4) or (n, 5), or else (n, 3), and none larger; it holds {held}"
        )
    return tables


def _parts(path: Path, arrays: Entries) -> dict[str, StoredArray]:
    """Find the arrays xyz and, if there, velocity and power."""
    xyz = arrays.get("xyz", "nothing")
    if not (_is_real(xyz) and len(xyz.shape) == 2 and xyz.shape[1] == 3):
        raise InputError(f"{path}: xyz takes real numbers of shape (n, 3), not {xyz}")
    parts, n = {"xyz": xyz}, xyz.shape[0]
    for name in ("velocity", "power"):
        if name in arrays:
            part = arrays[name]
            # MATLAB knows no vectors: a row, a column and a vector are the same here.
            if not (_is_real(part) and prod(part.shape) == n == max(part.shape, default=1)):
                raise InputError(f"{path}: {name} takes {n} real numbers, one a row of xyz, not {part}")
            parts[name] = part
    return parts


def _is_real(array: StoredArray | str) -> TypeGuard[StoredArray]:
    """Tell if an entry of a file is an array of integers or floats."""
    return isinstance(array, StoredArray) and array.dtype.kind in "fiu"


def _may_be_of_points(array: StoredArray | str, n: int) -> bool:
    """Tell if an entry of a file may have a number for each of n points; texts and scalars do not."""
    if isinstance(array, str):
        return array not in TEXTS
    return array.dtype.kind in "biufcV" and array.shape != () and prod(array.shape) >= min(n, 2) > 0


def _write_npy(points: Mapping[str, Floats], path: Path) -> None:
    columns = [*points.values()]
    if "v" not in points:
        if (points["power"] != 1).any():
            raise InputError(
                f"{path}: npy has no place for powers without velocities; allowed are csv, npz, mat and ply, "
                "or powers of 1"
            )
        columns.pop()
    # An open file, because numpy appends the extension to a path that ends in .NPY.
    with path.open("wb") as file:
        np.save(file, np.column_stack(columns))


def _named_arrays(points: Mapping[str, Floats]) -> dict[str, Any]:
    """Arrays of a cloud by their names in files."""
    xyz, velocity = np.column_stack([points[name] for name in "xyz"]), points.get("v")
    named = {"power": points["power"], **({} if velocity is None else {"velocity": velocity})}
    # xyz last: a file cut off between two arrays, which the parser accepts, then lacks what it cannot lack.
    return {**named, "xyz": xyz}


def _write_npz(points: Mapping[str, Floats], path: Path) -> None:
    with path.open("wb") as file:
        np.savez(file, **_named_arrays(points))


def _write_mat(points: Mapping[str, Floats], path: Path) -> None:
    from scipy.io import savemat

    path.open("wb").close()  # Says why a file cannot be written, which savemat does not.
    savemat(path, _named_arrays(points), appendmat=False, oned_as="column")


_READERS: dict[str, Callable[[Path], dict[str, Floats]]] = {
    ".csv": _read_csv,
    ".npy": _read_arrays,
    ".npz": _read_arrays,
    ".mat": _read_arrays,
    ".ply": read_ply,
}
_WRITERS: dict[str, Callable[[Mapping[str, Floats], Path], None]] = {
    ".csv": _write_csv,
    ".npy": _write_npy,
    ".npz": _write_npz,
    ".mat": _write_mat,
    ".ply": write_ply,
}
