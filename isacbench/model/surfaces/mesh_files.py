"""Meshes and cities from files: OBJ, PLY, STL, glTF, and scene lists of Mitsuba."""

import io
import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from isacbench.checked_arrays import Floats
from isacbench.errors import InputError, import_extra
from isacbench.files.checked_files import known_suffix, require_file, require_inside
from isacbench.files.escaping import quoted

MESH_BYTES = 2**28
"""Largest file of a mesh."""

LIST_BYTES = 2**24
"""Largest scene list."""

GLTF = ".glb", ".gltf"
SUFFIXES = *GLTF, ".obj", ".ply", ".stl"
TRIANGLE_FAN = 6
"""Mode of a primitive of glTF."""

MOST_SPANS = {False: 3.0, True: 50.0}
"""Largest side of a mesh, and of a city, in diagonals of the region: one in other units is larger."""

LEAST_SIDE_M = 0.05
"""Smallest longest side."""


def read_mesh(path: Path, scale: float | None, up: str | None, span_m: float) -> Floats:
    """Read the triangles (n, 3, 3) of a mesh or a city, corners in m and z up.

    The path is that of a file, or of a folder with one scene list of Mitsuba. Without a scale, the metres in
    a unit of the file, it is 1, and the size is checked by the diagonal of the region, `span_m`. By default z
    is up, and y in glTF as its standard says, unless trimesh wrote it, which keeps z.
    """
    if path.is_dir():
        path = _only_list(path)
    triangles = _listed_triangles(path) if path.suffix.lower() == ".xml" else _file_triangles(path, up)
    if up == "y" and path.suffix.lower() == ".xml":
        triangles = _y_up(triangles)
    if not len(triangles):
        raise InputError(f"{path}: has no triangles; allowed is a mesh with at least one")
    if not np.isfinite(triangles).all():
        raise InputError(f"{path}: has vertices that are no finite numbers")
    is_city = path.suffix.lower() in (*GLTF, ".xml")
    longest_m, most_m = np.ptp(triangles, axis=(0, 1)).max(), MOST_SPANS[is_city] * span_m
    if scale is None and not LEAST_SIDE_M <= longest_m <= most_m:
        raise InputError(
            f"{path}: its bounding box is {box_of(triangles)}, which is no size in metres of an object in "
            f"this region; allowed are longest sides from {LEAST_SIDE_M:g} to {most_m:.4g} m, or "
            "a scale, the metres in a unit of the file: 0.001 for millimetres, 1 for metres"
        )
    return triangles * (1.0 if scale is None else scale)


def box_of(triangles: Floats) -> str:
    """Describe a bounding box."""
    limits = zip("xyz", triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1)), strict=True)
    return ", ".join(f"{axis} {low:g} to {high:g}" for axis, low, high in limits) + " m"


def _file_triangles(path: Path, up: str | None) -> Floats:
    """Triangles of one file; all its parts, each in its place."""
    kind = known_suffix(path, SUFFIXES, "allowed are a folder with one .xml, .xml,")
    require_file(path, MESH_BYTES)
    content = path.read_bytes()
    if kind in GLTF:
        wrote = _require_plain_gltf(path, content)
        up = up or ("z" if "trimesh" in wrote else "y")
    trimesh: Any = import_extra("trimesh", "meshes", str(path))
    try:
        # The resolver refuses buffers outside the folder of the file.
        scene = trimesh.load_scene(
            io.BytesIO(content),
            file_type=kind[1:],
            resolver=trimesh.resolvers.FilePathResolver(str(path)),
            process=False,
            skip_materials=True,
        )
        mesh = scene.to_mesh() if scene.geometry else None
        triangles = np.empty((0, 3, 3)) if mesh is None else np.array(mesh.triangles, dtype=np.float64)
    except Exception as error:  # a parser fails in its own ways
        raise InputError(f"{path}: cannot be read as {kind[1:]}: {quoted(str(error))}") from error
    return _y_up(triangles) if up == "y" else triangles


def _require_plain_gltf(path: Path, content: bytes) -> str:
    """Refuse glTF whose triangles trimesh would lose without a word; return the name of what wrote it."""
    try:
        if content[:4] == b"glTF":  # glb: 12 bytes of header, then length, type and text of the JSON
            content = content[20 : 20 + int.from_bytes(content[12:16], "little")]
        header = json.loads(content)
        primitives = [one for mesh in header.get("meshes", ()) for one in mesh.get("primitives", ())]
        required = header.get("extensionsRequired", ())
        used = [name for name in required if re.search("compression|quantization", name)]
        used += ["TRIANGLE_FAN"] if any(one.get("mode") == TRIANGLE_FAN for one in primitives) else []
        wrote = str(header.get("asset", {}).get("generator", ""))
    except (ValueError, AttributeError, TypeError) as error:
        raise InputError(f"{path}: cannot be read as {path.suffix[1:]}: {quoted(str(error))}") from error
    if used:
        raise InputError(
            f"{path}: uses {', '.join(used)}; allowed is glTF with plain triangles, not compressed"
        )
    return wrote


def _y_up(triangles: Floats) -> Floats:
    """Turn what has y up."""
    x, y, z = np.moveaxis(triangles, -1, 0)
    return np.stack([x, -z, y], axis=-1)


def _only_list(folder: Path) -> Path:
    lists = sorted(folder.glob("*.xml"))
    if len(lists) != 1:
        raise InputError(f"{folder}: has {len(lists)} scene lists; allowed is a folder with one .xml")
    require_inside(lists[0], folder)
    return lists[0]


def _listed_triangles(path: Path) -> Floats:
    """Triangles of the shapes that a scene list of Mitsuba names."""
    require_file(path, LIST_BYTES)
    try:
        root = ElementTree.fromstring(path.read_bytes())
    except (ElementTree.ParseError, ValueError, LookupError) as error:  # the last two of encodings
        raise InputError(f"{path}: cannot be read as xml: {quoted(str(error))}") from error
    parts = [np.empty((0, 3, 3))]
    for shape in root.iter("shape"):
        name = shape.find("string[@name='filename']")
        if name is None:
            kind = quoted(shape.get("type", ""))
            raise InputError(f"{path}: a shape of type {kind} has no filename; allowed are shapes from files")
        file = path.parent / name.get("value", "")
        require_inside(file, path.parent)
        corners = _file_triangles(file, "z").reshape(-1, 3)
        for transform in shape.findall("transform[@name='to_world']"):
            for step in transform:
                matrix = _matrix(step, path)
                corners = corners @ matrix[:3, :3].T + matrix[:3, 3]
        parts.append(corners.reshape(-1, 3, 3))
    return np.concatenate(parts)


def _matrix(step: ElementTree.Element, path: Path) -> Floats:
    """Matrix (4, 4) of a step of a transformation."""
    matrix = np.eye(4)
    try:
        given = [float(step.get(axis, "1" if step.tag == "scale" else "0")) for axis in "xyz"]
        values = np.array([float(word) for word in step.get("value", "").replace(",", " ").split()] or given)
        match step.tag:
            case "matrix":
                matrix = values.reshape(4, 4)
            case "translate":
                matrix[:3, 3] = values
            case "scale":
                matrix[range(3), range(3)] = values
            case "rotate" if values.any():
                turn = float(step.get("angle", "0")) / np.linalg.norm(values)
                matrix[:3, :3] = Rotation.from_rotvec(turn * values, degrees=True).as_matrix()
            case _:
                raise ValueError(
                    "allowed are matrix, translate, scale, and rotate about an axis that is not 0"
                )
    except ValueError as error:
        raise InputError(f"{path}: {step.tag} of a to_world transform: {error}") from error
    return matrix
