"""Points as PLY files: ASCII written, ASCII and binary read.

The header is read here, because libraries of meshes drop in silence what they do not know or what is too much
in a row. NumPy reads binary rows, and ASCII rows are those of a csv file.
"""

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from isacbench.checked_arrays import Floats
from isacbench.errors import InputError
from isacbench.files.escaping import quoted, shortened
from isacbench.model.cloud_files.tables import BLANKS, CsvTable, find_columns, require_finite, split_rows

_FILE = re.compile(
    rb"(?:\xef\xbb\xbf)?ply[ \t]*\r?\n(?P<header>(?:.*\n)*?)end_header[ \t]*\r?(?:\n|\Z)(?P<body>(?s:.*))"
)
_TYPES = {
    name: code
    for names, code in (
        *(("char int8", "i1"), ("uchar uint8", "u1"), ("short int16", "i2"), ("ushort uint16", "u2")),
        *(("int int32", "i4"), ("uint uint32", "u4"), ("float float32", "f4"), ("double float64", "f8")),
    )
    for name in names.split()
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
LIST = "list"
"""Type of a property of several numbers."""


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

    The first element is ``vertex`` with the properties x, y and z; v (or velocity) and power are optional and
    others are ignored, as are other elements. A v beside u or s belongs to a texture or a colour.
    """
    match = _FILE.fullmatch(path.read_bytes())
    if not match:
        raise InputError(f"{path}: is no PLY file, which starts with 'ply' and has a line 'end_header'")
    header, body = match["header"].decode("latin-1").splitlines(), match["body"]
    order, n, properties, n_elements = _parsed_header(path, header)
    names = [name for name, _ in properties]
    columns = find_columns(path, "element vertex", names)
    if LIST in (kind for _, kind in properties):
        raise InputError(f"{path}: element vertex: has a list property; only plain ones can be read")
    if not order:
        lines = enumerate(body.decode("ascii", "replace").splitlines(), len(header) + 3)
        rows = [(number, line) for number, line in lines if line.strip()]
        n_held = len(rows)
        if n_held > n and n_elements == 1:
            raise InputError(f"{path}: row {rows[n][0]}: is one too many; the header allows {n}")
    else:
        layout = np.dtype([("", order + kind) for _, kind in properties])
        n_held = len(body) // layout.itemsize
    if n_held < n:
        raise InputError(f"{path}: is truncated: {n_held} of {n} vertices")
    if not order:
        numbers, fields = [number for number, _ in rows[:n]], split_rows(path, rows[:n], BLANKS, len(names))
        values = CsvTable(path, fields, numbers, BLANKS, [], "").values(names, [*columns.values()])
    else:
        records = np.frombuffer(body, layout, n) if n else np.empty(0, layout)
        values = np.column_stack([records[f"f{k}"].astype(np.float64) for k in columns.values()])
        require_finite(path, values, [*columns], range(1, n + 1))
    return dict(zip(columns, values.T, strict=True))


def _parsed_header(path: Path, lines: list[str]) -> tuple[str, int, list[tuple[str, str]], int]:
    """Byte order, none of text; number of vertices, their properties; number of elements."""
    order: str | None = None
    elements: list[tuple[str, int]] = []
    properties: list[tuple[int, str, str]] = []
    for row, line in enumerate(lines, 2):
        match line.split():
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", form, "1.0"] if form in _ORDERS:
                order = _ORDERS[form]
            case ["element", name, count] if re.fullmatch("[0-9]{1,18}", count):
                elements.append((name, int(count)))
            case ["property", kind, name] if elements and kind in _TYPES:
                properties.append((len(elements), name, _TYPES[kind]))
            case ["property", "list", _, _, name] if elements:
                properties.append((len(elements), name, LIST))
            case _:
                raise InputError(
                    f"{path}: row {row}: {quoted(line[:60])} does not belong in a PLY 1.0 header"
                )
    if order is None or [name for name, _ in elements[:1]] != ["vertex"]:
        names = shortened(", ".join(name for name, _ in elements)) or "none"
        raise InputError(
            f"{path}: takes a line 'format' and the first element 'vertex'; its elements: {names}"
        )
    of_vertex = [(name, kind) for element, name, kind in properties if element == 1]
    return order, elements[0][1], of_vertex, len(elements)
