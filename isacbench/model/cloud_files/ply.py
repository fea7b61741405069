"""Points as PLY files: ASCII written, ASCII and binary read.

The header is read here, because libraries of meshes drop in silence what they do not know or what is too much
in a row. NumPy reads binary rows, and ASCII rows are those of a csv file.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from isacbench.checked_arrays import Floats
from isacbench.errors import InputError
from isacbench.files.escaping import quoted, shortened
from isacbench.model.cloud_files.columns import find_columns
from isacbench.model.cloud_files.csv_tables import BLANKS, CsvTable, require_finite

_START = re.compile(rb"(?:\xef\xbb\xbf)?ply[ \t]*(\r\n|\r|\n)")
_TYPES = {
    name: code
    for names, code in (
        *(("char int8", "i1"), ("uchar uint8", "u1"), ("short int16", "i2"), ("ushort uint16", "u2")),
        *(("int int32", "i4"), ("uint uint32", "u4"), ("float float32", "f4"), ("double float64", "f8")),
    )
    for name in names.split()
}
_TYPE = "|".join(_TYPES)
_LINE = re.compile(
    r"format (ascii|binary_little_endian|binary_big_endian) 1\.0|element \S+ [0-9]{1,18}"
    rf"|property (?:{_TYPE}) \S+|property list (?:{_TYPE}) (?:{_TYPE}) \S+"
)
LIST = "list"
"""Type of a property of several numbers."""

Elements = dict[str, tuple[int, dict[str, str]]]
"""Length of each element and types of its properties, by their names."""


def write_ply(points: Mapping[str, Floats], path: Path) -> None:
    """Write points, columns by the names of properties, as ASCII PLY with double properties."""
    header = [
        "ply",
        "format ascii 1.0",
        "comment x y z in m, v in m/s and positive when approaching, power relative to a unit scatterer",
        f"element vertex {len(points['x'])}",
        *(f"property double {name}" for name in points),
        "end_header",
    ]
    rows = (" ".join(map(repr, row)) for row in np.column_stack([*points.values()]).tolist())
    path.write_text("\n".join([*header, *rows, ""]), encoding="ascii", newline="\n")


def read_ply(path: Path) -> dict[str, Floats]:
    """Read the vertices of a PLY file, ASCII or binary of either byte order, as points.

    The element ``vertex`` needs the properties x, y and z; v (or velocity) and
    power are optional and others are ignored, as are other elements. A v beside
    u or s belongs to a texture or a colour.
    """
    content = path.read_bytes()
    start = _START.match(content)
    if not start:
        raise InputError(f"{path}: row 1: is not a PLY file, which starts with 'ply'")
    line_end = start[1]
    end = re.compile(line_end + rb"end_header[ \t]*(?:" + line_end + rb"|\Z)").search(
        content, start.end() - len(line_end)
    )
    header = content[start.end() : end.start() if end else None].decode("latin-1").split(line_end.decode())
    form, elements = _parsed_header(path, header)
    if not end:
        raise InputError(f"{path}: the header has no line 'end_header'; is the file truncated?")
    if "vertex" not in elements:
        raise InputError(
            f"{path}: has no element 'vertex'; its elements: {shortened(', '.join(elements)) or 'none'}"
        )
    n, types = elements["vertex"]
    if LIST in types.values():
        raise InputError(f"{path}: element vertex: has a list property; only plain ones can be read")
    columns = find_columns(path, "element vertex", [*types])
    before = [elements[name] for name in [*elements][: [*elements].index("vertex")]]
    body = content[end.end() :]
    if form == "ascii":
        first = sum(count for count, _ in before)
        n_rows = sum(count for count, _ in elements.values())
        values = _ascii_table(path, body, len(header) + 3, (first, n, n_rows)).values(
            [*types], [*columns.values()]
        )
    else:
        order = "<" if form == "binary_little_endian" else ">"
        if any(LIST in one.values() and count for count, one in before):
            raise InputError(f"{path}: has lists before its vertices, which only an ASCII file may have")
        offset = sum(count * _layout(one, order).itemsize for count, one in before if count)
        layout = _layout(types, order)
        _require_whole(path, (len(body) - offset) // layout.itemsize, n)
        records = np.frombuffer(body, layout, n, offset) if n else np.empty(0, layout)
        values = np.column_stack([records[[*types][k]].astype(np.float64) for k in columns.values()])
        require_finite(path, values, [*columns], range(1, n + 1))
    return dict(zip(columns, values.T, strict=True))


def _parsed_header(path: Path, lines: list[str]) -> tuple[str, Elements]:
    """Format and elements that the lines between ``ply`` and ``end_header`` announce."""
    form, element, seen = "", "", set()
    elements: Elements = {}
    for row, text in enumerate(lines, start=2):
        kind, *words = text.split() or ["comment"]
        if kind in ("comment", "obj_info"):
            continue
        if not _LINE.fullmatch(" ".join([kind, *words])) or (kind == "property" and not element):
            raise InputError(
                f"{path}: row {row}: {quoted(text.strip()[:60])} does not belong in a PLY 1.0 header"
            )
        element = words[0] if kind == "element" else element
        name = {"format": "line format", "element": f"element {element}"}.get(kind, f"property {words[-1]}")
        if (key := name if kind != "property" else f"{element} {name}") in seen:
            raise InputError(f"{path}: row {row}: {name} appears twice")
        seen.add(key)
        if kind == "format":
            form = words[0]
        elif kind == "element":
            elements[element] = int(words[1]), {}
        else:
            elements[element][1][words[-1]] = words[0]
    if not form:
        raise InputError(f"{path}: the header has no line 'format'")
    return form, elements


def _layout(types: dict[str, str], order: str) -> np.dtype[np.void]:
    return np.dtype([(name, order + _TYPES[kind]) for name, kind in types.items()])


def _ascii_table(path: Path, body: bytes, first_row: int, counts: tuple[int, int, int]) -> CsvTable:
    """Rows of the vertices of an ASCII file, one line each: (rows before them, their number, all rows)."""
    first, n, n_rows = counts
    lines = re.sub("\r\n?", "\n", body.decode("ascii", "replace")).split("\n")
    rows = [(number, line) for number, line in enumerate(lines, first_row) if line.strip()]
    _require_whole(path, len(rows) - first, n)
    vertices = rows[first : first + n]
    if len(rows) > n_rows:
        raise InputError(f"{path}: row {rows[n_rows][0]}: is one too many; the header allows {n_rows}")
    return CsvTable(path, [line for _, line in vertices], [number for number, _ in vertices], BLANKS, [], "")


def _require_whole(path: Path, held: int, announced: int) -> None:
    """Refuse a file with fewer vertices than its header announces."""
    if held < announced:
        raise InputError(f"{path}: is truncated: {max(held, 0)} of {announced} vertices")
