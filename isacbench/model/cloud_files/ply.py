"""Points as PLY files: ASCII written, ASCII and binary read."""

from __future__ import annotations

from dataclasses import dataclass, field
from io import BytesIO
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from isacbench.errors import InputError
from isacbench.files.escaping import shortened
from isacbench.files.text_table import TextLine, check_finite, format_rows, parse_rows

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

Floats = NDArray[np.float64]

MOST_DIGITS = 18
"""Of a count: what has more is no number of anything."""

_PROPERTIES = ("x", "y", "z", "v", "power")
_BYTE_ORDER = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_TYPE_CODES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}


@dataclass
class _Element:
    """One element of a PLY header: its property names and type codes, in order."""

    name: str
    count: int
    codes: dict[str, str] = field(default_factory=dict)
    has_list: bool = False

    def dtype(self, byte_order: str) -> np.dtype[np.void]:
        """Layout of one binary record."""
        return np.dtype([(name, byte_order + code) for name, code in self.codes.items()])


@dataclass
class _Header:
    """What precedes the data of a PLY file."""

    byte_order: str
    elements: list[_Element]
    n_lines: int
    n_bytes: int


def write_ply(points: Floats, path: Path) -> None:
    """Write points (n, 5) as ASCII PLY with the double properties x, y, z, v and power.

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
        *(f"property double {name}" for name in _PROPERTIES),
        "end_header",
    ]
    rows = format_rows(points, delimiter=" ")
    path.write_text("\n".join([*header, *rows, ""]), encoding="ascii", newline="\n")


def read_ply(path: Path) -> Floats:
    """Read the vertices of a PLY file, ASCII or binary of either byte order, as points (n, 4) or (n, 5).

    The element ``vertex`` needs the properties x, y, z and v (or velocity);
    power is optional and others are ignored, as are other elements.

    Raises
    ------
    InputError
        If the file is no such PLY, is truncated, or holds NaN or infinity.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    header = _parse_header(path, data)
    before, vertex = _split_at_vertex(path, header.elements)
    columns = _wanted_properties(path, vertex)
    values = (_binary_vertices if header.byte_order else _ascii_vertices)(path, data, header, before, vertex)
    return values[:, [list(vertex.codes).index(name) for name in columns]]


def _parse_header(path: Path, data: bytes) -> _Header:
    """Read the header up to and with its last line."""
    if not data.startswith(b"ply"):
        raise InputError(f"{path}: row 1: is not a PLY file, which starts with 'ply'")
    byte_order = None
    elements: list[_Element] = []
    n_bytes = 0
    for number, raw in enumerate(BytesIO(data), start=1):
        n_bytes += len(raw)
        match raw.decode("latin-1").split():
            case ["end_header"]:
                if byte_order is None:
                    raise InputError(f"{path}: the header has no line 'format'")
                return _Header(byte_order, elements, n_lines=number, n_bytes=n_bytes)
            case ["format", ("ascii" | "binary_little_endian" | "binary_big_endian") as name, "1.0"]:
                byte_order = _BYTE_ORDER[name]
            case ["element", name, count] if count.isdecimal() and len(count) <= MOST_DIGITS:
                elements.append(_Element(name, int(count)))
            case ["property", "list", _, _, _] if elements:
                elements[-1].has_list = True
            case ["property", type_name, name] if elements and type_name in _TYPE_CODES:
                if name in elements[-1].codes:
                    raise InputError(f"{path}: row {number}: property {name} appears twice")
                elements[-1].codes[name] = _TYPE_CODES[type_name]
            case ["ply"] if number == 1:
                pass
            case ["comment" | "obj_info", *_]:
                pass
            case _:
                line = raw.decode("latin-1").strip()
                raise InputError(f"{path}: row {number}: {line[:60]!r} does not belong in a PLY 1.0 header")
    raise InputError(f"{path}: the header has no line 'end_header'; is the file truncated?")


def _split_at_vertex(path: Path, elements: list[_Element]) -> tuple[list[_Element], _Element]:
    """Separate the element ``vertex`` from those before it."""
    names = [element.name for element in elements]
    if "vertex" not in names:
        raise InputError(
            f"{path}: has no element 'vertex'; its elements: {shortened(', '.join(names)) or 'none'}"
        )
    place = names.index("vertex")
    return elements[:place], elements[place]


def _wanted_properties(path: Path, vertex: _Element) -> list[str]:
    """Names of the properties that hold x, y, z, v and, if there, power."""
    if vertex.has_list:
        raise InputError(f"{path}: element vertex: has a list property; only plain ones can be read")
    speeds = [name for name in ("v", "velocity") if name in vertex.codes]
    missing = [name for name in ("x", "y", "z") if name not in vertex.codes]
    if missing or len(speeds) != 1:
        raise InputError(
            f"{path}: element vertex: takes properties x, y, z and either v or velocity, optionally power; "
            f"it has {shortened(', '.join(vertex.codes)) or 'none'}"
        )
    return ["x", "y", "z", *speeds, *(name for name in ("power",) if name in vertex.codes)]


def _ascii_vertices(
    path: Path, data: bytes, header: _Header, before: list[_Element], vertex: _Element
) -> Floats:
    """All properties (n, k) of the vertices of an ASCII file, one line each."""
    start = sum(element.count for element in before)
    n_lines = sum(1 for _ in _text_lines(data, header))
    held = max(n_lines - start, 0)
    if held < vertex.count:
        raise _truncated(path, held, vertex.count)
    rows = islice(_text_lines(data, header), min(start, n_lines), min(start + vertex.count, n_lines))
    return parse_rows(path, rows, list(vertex.codes), delimiter=None)


def _text_lines(data: bytes, header: _Header) -> Iterator[TextLine]:
    """Lines below the header that are not blank."""
    file = BytesIO(data)
    file.seek(header.n_bytes)
    for number, line in enumerate(file, start=header.n_lines + 1):
        if line.strip():
            yield TextLine(number, line.decode("latin-1"))


def _binary_vertices(
    path: Path, data: bytes, header: _Header, before: list[_Element], vertex: _Element
) -> Floats:
    """All properties (n, k) of the vertices of a binary file."""
    listed = [element.name for element in before if element.has_list]
    if listed:
        raise InputError(f"{path}: element {listed[0]}: has a list property before the element vertex")
    start = header.n_bytes + sum(
        element.count * element.dtype(header.byte_order).itemsize for element in before
    )
    layout = vertex.dtype(header.byte_order)
    held = max(len(data) - start, 0) // layout.itemsize
    if held < vertex.count:
        raise _truncated(path, held, vertex.count)
    records = np.frombuffer(data, layout, count=vertex.count, offset=min(start, len(data)))
    names = list(vertex.codes)
    values = np.column_stack([records[name].astype(np.float64) for name in names])
    check_finite(path, values, names, range(1, vertex.count + 1))
    return values


def _truncated(path: Path, held: int, announced: int) -> InputError:
    """Error of a file with fewer vertices than its header announces."""
    return InputError(f"{path}: is truncated: {held} of {announced} vertices")
