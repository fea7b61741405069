"""Points as PLY files: ASCII written, ASCII and binary read."""

from __future__ import annotations

import io
import re
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from isacbench.errors import InputError
from isacbench.files.escaping import quoted, shortened
from isacbench.files.text_table import BLANKS, TextTable, check_finite, format_rows, parse_numbers, split_text
from isacbench.model.cloud_files.columns import find_columns

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

Floats = NDArray[np.float64]
Elements = dict[str, dict[str, Any]]
"""Elements that trimesh finds in a header: ``length``, ``properties`` by name, and ``data`` once read."""

_START = re.compile(rb"(?:\xef\xbb\xbf)?ply[ \t]*(\r\n|\r|\n)")
_TYPE = r"(?:u?(?:char|short|int|int8|int16|int32)|float|double|float32|float64)"
_LINE = re.compile(
    r"format (ascii|binary_little_endian|binary_big_endian) 1\.0|element \S+ [0-9]{1,18}"
    rf"|property {_TYPE} \S+|property list {_TYPE} {_TYPE} \S+"
)
"""Lines of a header that trimesh understands; it misreads others in silence."""


def write_ply(points: Mapping[str, Floats], path: Path) -> None:
    """Write points as ASCII PLY with double properties.

    Parameters
    ----------
    points : mapping of str to ndarray of float64, shape (n,)
        By the names of the properties.
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
        f"element vertex {len(points['x'])}",
        *(f"property double {name}" for name in points),
        "end_header",
    ]
    rows = format_rows(np.column_stack([*points.values()]), delimiter=" ")
    path.write_text("\n".join([*header, *rows, ""]), encoding="ascii", newline="\n")


def read_ply(path: Path) -> dict[str, Floats]:
    """Read the vertices of a PLY file, ASCII or binary of either byte order, as points.

    The element ``vertex`` needs the properties x, y and z; v (or velocity) and
    power are optional and others are ignored, as are other elements. A v beside
    u or s belongs to a texture or a colour.

    Parameters
    ----------
    path : Path

    Returns
    -------
    dict of str to ndarray of float64, shape (n,)

    Raises
    ------
    InputError
        If the file is no such PLY, is truncated, or holds NaN or infinity.
    """
    content = path.read_bytes()
    start = _START.match(content)
    if not start:
        raise InputError(f"{path}: row 1: is not a PLY file, which starts with 'ply'")
    end = re.compile(start[1] + rb"end_header[ \t]*(?:" + start[1] + rb"|\Z)").search(
        content, start.end() - 2
    )
    header = content[start.end() : end.start() if end else None].decode("latin-1").split(start[1].decode())
    elements, is_ascii = _parsed_header(path, header)
    if not end:
        raise InputError(f"{path}: the header has no line 'end_header'; is the file truncated?")
    if "vertex" not in elements:
        raise InputError(
            f"{path}: has no element 'vertex'; its elements: {shortened(', '.join(elements)) or 'none'}"
        )
    types = elements["vertex"]["properties"]
    if any("$LIST" in kind for kind in types.values()):
        raise InputError(f"{path}: element vertex: has a list property; only plain ones can be read")
    columns = find_columns(path, "element vertex", [*types])
    body = content[end.end() :]
    if is_ascii:
        values = _ascii_vertices(path, body, len(header) + 3, elements, [*columns.values()])
    else:
        records = _binary_vertices(path, body, elements)
        values = np.column_stack([records[[*types][k]].astype(np.float64) for k in columns.values()])
        check_finite(path, values, [*columns], range(1, len(values) + 1))
    return dict(zip(columns, values.T, strict=True))


def _parsed_header(path: Path, lines: list[str]) -> tuple[Elements, bool]:
    """Elements that the lines between ``ply`` and ``end_header`` announce, and whether they are in ASCII."""
    from trimesh.exchange import ply  # which takes longer to load than all that other formats need

    kept: list[str] = []
    element, seen = "", set()
    for row, text in enumerate(lines, start=2):
        line = " ".join(text.split())
        kind, *words = line.split() or ["comment"]
        if kind in ("comment", "obj_info"):
            continue
        if not _LINE.fullmatch(line) or (kind == "property" and not element):
            raise InputError(
                f"{path}: row {row}: {quoted(text.strip()[:60])} does not belong in a PLY 1.0 header"
            )
        element = words[0] if kind == "element" else element
        name = {"format": "line format", "element": f"element {element}"}.get(kind, f"property {words[-1]}")
        if (key := name if kind != "property" else f"{element} {name}") in seen:
            raise InputError(f"{path}: row {row}: {name} appears twice")
        seen.add(key)
        kept.insert(0 if kind == "format" else len(kept), line)
    if "line format" not in seen:
        raise InputError(f"{path}: the header has no line 'format'")
    elements, is_ascii, _ = ply._parse_header(io.BytesIO("\n".join(["ply", *kept, "end_header"]).encode()))
    return dict(elements), bool(is_ascii)


def _ascii_vertices(path: Path, body: bytes, first_row: int, elements: Elements, wanted: list[int]) -> Floats:
    """Columns (n, k) of the vertices of an ASCII file, one line each.

    trimesh drops what is too much in a row, and takes fewer rows than are announced.
    """
    rows = split_text(body.decode("ascii", "replace"), first_row)
    start = sum(elements[name]["length"] for name in [*elements][: [*elements].index("vertex")])
    n = elements["vertex"]["length"]
    _require_whole(path, len(rows.lines) - start, n)
    table = TextTable(rows.lines[start : start + n], rows.numbers[start : start + n], BLANKS)
    values = parse_numbers(path, table, [*elements["vertex"]["properties"]], wanted)
    if len(rows.lines) > (total := sum(element["length"] for element in elements.values())):
        raise InputError(f"{path}: row {rows.numbers[total]}: is one too many; the header allows {total}")
    return values


def _binary_vertices(path: Path, body: bytes, elements: Elements) -> NDArray[np.void]:
    """Vertices of a binary file."""
    from trimesh.exchange import ply

    before = {name: elements[name] for name in [*elements][: [*elements].index("vertex") + 1]}
    sizes = [
        one["length"] * np.dtype([*one["properties"].items()]).itemsize
        for one in before.values()
        if not any("$LIST" in kind for kind in one["properties"].values())
    ]
    vertex = elements["vertex"]
    if len(sizes) == len(before):
        # What follows is cut off: trimesh cannot read lists of several lengths, which faces may be.
        elements, body = before, body[: sum(sizes)]
        layout = np.dtype([*vertex["properties"].items()])
        _require_whole(path, (len(body) - sum(sizes[:-1])) // layout.itemsize, vertex["length"])
    if not vertex["length"]:
        return np.empty(0, [*vertex["properties"].items()])
    elements = {name: one for name, one in elements.items() if one["length"] and one["properties"]}
    try:
        ply._ply_binary(elements, io.BytesIO(body))
        same = all(
            (data[name]["f0"] == data.dtype[name]["f1"].shape[0]).all()
            for data in (one["data"] for one in elements.values())
            for name in data.dtype.names
            if data.dtype[name].names
        )
    except Exception as error:  # a parser fails in its own ways
        raise InputError(f"{path}: cannot be read as ply: {quoted(str(error))}") from error
    if not same:
        raise InputError(f"{path}: has lists of several lengths around a list before its vertices")
    records: NDArray[np.void] = vertex["data"]
    return records


def _require_whole(path: Path, held: int, announced: int) -> None:
    """Refuse a file with fewer vertices than its header announces."""
    if held < announced:
        raise InputError(f"{path}: is truncated: {max(held, 0)} of {announced} vertices")
