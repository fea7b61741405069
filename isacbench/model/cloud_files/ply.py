"""Points as PLY files: ASCII written, ASCII and binary read."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from isacbench.errors import InputError
from isacbench.files.escaping import shortened
from isacbench.files.text_table import TextLine, check_finite, format_rows, parse_rows
from isacbench.model.cloud_files.power_names import require_no_power

if TYPE_CHECKING:
    from pathlib import Path

Floats = NDArray[np.float64]

MOST_DIGITS = 18
"""Of a count: what has more is no number of anything."""

_BYTE_ORDER = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_LIST = "list"
_SIGNED = {"char": "int8", "short": "int16", "int": "int32"}
_UNSIGNED = {f"u{name}": f"u{number}" for name, number in _SIGNED.items()}
_TYPES = {**_SIGNED, **_UNSIGNED, "float": "float32", "double": "float64"}
_TYPES.update({number: number for number in _TYPES.values()})
"""NumPy's names of the types of properties, which PLY files name as C or as NumPy does."""

_BESIDE_OTHER_V = re.compile(r"(.*[_ ])?(t?u|s)", re.IGNORECASE)
"""Properties of a texture or a colour, whose v is no velocity."""


@dataclass
class _Element:
    """Element of a PLY header: its names and types of the properties, in order."""

    name: str
    count: int
    types: dict[str, str] = field(default_factory=dict)

    @property
    def has_list(self) -> bool:
        """True if the records differ in length."""
        return _LIST in self.types.values()

    def dtype(self, byte_order: str) -> np.dtype[np.void]:
        """Layout of one binary record."""
        return np.dtype([(name, byte_order + np.dtype(kind).str[1:]) for name, kind in self.types.items()])


def write_ply(points: Floats, path: Path) -> None:
    """Write points as ASCII PLY with the double properties x, y, z, v and power.

    Parameters
    ----------
    points : ndarray of float64, shape (n, 5)
    path : Path

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    header = [
        "ply",
        "format ascii 1.0",
        "comment x y z in m, v in m/s and positive when approaching, power relative to a unit scatterer",
        f"element vertex {len(points)}",
        *(f"property double {name}" for name in ("x", "y", "z", "v", "power")),
        "end_header",
    ]
    rows = format_rows(points, delimiter=" ")
    path.write_text("\n".join([*header, *rows, ""]), encoding="ascii", newline="\n")


def read_ply(path: Path) -> Floats:
    """Read the vertices of a PLY file, ASCII or binary of either byte order, as points.

    The element ``vertex`` needs the properties x, y, z and v (or velocity);
    power is optional and others are ignored, as are other elements. A v beside
    u or s belongs to a texture or a colour.

    Parameters
    ----------
    path : Path

    Returns
    -------
    ndarray of float64, shape (n, 4) or (n, 5)

    Raises
    ------
    InputError
        If the file is no such PLY, is truncated, or holds NaN or infinity.
    """
    header, end, rest = path.read_bytes().partition(b"\nend_header")
    lines = header.decode("latin-1").split("\n")
    byte_order, elements = _parse_header(path, lines)
    if not end:
        raise InputError(f"{path}: the header has no line 'end_header'; is the file truncated?")
    names = [element.name for element in elements]
    if "vertex" not in names:
        raise InputError(
            f"{path}: has no element 'vertex'; its elements: {shortened(', '.join(names)) or 'none'}"
        )
    before, vertex = elements[: names.index("vertex")], elements[names.index("vertex")]
    columns = _wanted_properties(path, vertex)
    body = rest.partition(b"\n")[2]
    if not byte_order:
        return _ascii_vertices(path, body, len(lines) + 2, before, vertex, columns)
    return _binary_vertices(path, body, byte_order, before, vertex, columns)


def _parse_header(path: Path, lines: list[str]) -> tuple[str, list[_Element]]:
    """Byte order, empty for ASCII, and elements that the lines of a header announce."""
    if not lines[0].startswith("ply"):
        raise InputError(f"{path}: row 1: is not a PLY file, which starts with 'ply'")
    byte_order = None
    elements: list[_Element] = []
    for number, line in enumerate(lines[1:], start=2):
        match line.split():
            case ["format", name, "1.0"] if name in _BYTE_ORDER:
                byte_order = _BYTE_ORDER[name]
            case ["element", name, count] if count.isdecimal() and len(count) <= MOST_DIGITS:
                elements.append(_Element(name, int(count)))
            case ["property", "list", _, _, name] if elements:
                elements[-1].types[name] = _LIST
            case ["property", type_name, name] if elements and type_name in _TYPES:
                if name in elements[-1].types:
                    raise InputError(f"{path}: row {number}: property {name} appears twice")
                elements[-1].types[name] = _TYPES[type_name]
            case ["comment" | "obj_info", *_]:
                pass
            case [] if number == len(lines):
                pass  # behind the last line of a header that has no end
            case _:
                raise InputError(
                    f"{path}: row {number}: {line.strip()[:60]!r} does not belong in a PLY 1.0 header"
                )
    if byte_order is None:
        raise InputError(f"{path}: the header has no line 'format'")
    return byte_order, elements


def _wanted_properties(path: Path, vertex: _Element) -> list[str]:
    """Names of the properties that hold x, y, z, v and, if there, power."""
    if vertex.has_list:
        raise InputError(f"{path}: element vertex: has a list property; only plain ones can be read")
    wanted: list[str] = [name for name in ("x", "y", "z", "v", "velocity", "power") if name in vertex.types]
    beside = next(filter(_BESIDE_OTHER_V.fullmatch, vertex.types), None) if "v" in wanted else None
    if beside:
        wanted.remove("v")
    speeds = {"v", "velocity"} & {*wanted}
    if wanted[:3] != ["x", "y", "z"] or len(speeds) != 1:
        raise InputError(
            f"{path}: element vertex: takes properties x, y, z and either v or velocity, optionally power; "
            f"it has {shortened(', '.join(vertex.types)) or 'none'}"
            f"{f', where v beside {beside} is of a texture' if beside else ''}"
        )
    if "power" not in wanted:
        require_no_power(path, vertex.types)
    return wanted


def _ascii_vertices(
    path: Path, body: bytes, first_row: int, before: list[_Element], vertex: _Element, columns: list[str]
) -> Floats:
    """Columns (n, k) of the vertices of an ASCII file, one line each."""
    text = body.decode("ascii", "replace").split("\n")
    lines = [TextLine(number, line) for number, line in enumerate(text, first_row) if line.strip()]
    start = sum(element.count for element in before)
    _require_whole(path, len(lines) - start, vertex.count)
    names = list(vertex.types)
    values = parse_rows(path, lines[start : start + vertex.count], names, delimiter=None)
    return values[:, [names.index(name) for name in columns]]


def _binary_vertices(
    path: Path, body: bytes, byte_order: str, before: list[_Element], vertex: _Element, columns: list[str]
) -> Floats:
    """Columns (n, k) of the vertices of a binary file."""
    listed = [element.name for element in before if element.has_list]
    if listed:
        raise InputError(f"{path}: element {listed[0]}: has a list property before the element vertex")
    start = sum(element.count * element.dtype(byte_order).itemsize for element in before)
    layout = vertex.dtype(byte_order)
    _require_whole(path, (len(body) - start) // layout.itemsize, vertex.count)
    records = np.frombuffer(body[start:], layout, vertex.count)
    values = np.column_stack([records[name].astype(np.float64) for name in columns])
    check_finite(path, values, columns, range(1, vertex.count + 1))
    return values


def _require_whole(path: Path, held: int, announced: int) -> None:
    """Refuse a file with fewer vertices than its header announces."""
    if held < announced:
        raise InputError(f"{path}: is truncated: {max(held, 0)} of {announced} vertices")
