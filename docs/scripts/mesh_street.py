"""Write the meshes of the scenario mesh-street, boxes and cylinders, as PLY files into scenarios/meshes.

python docs/scripts/mesh_street.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from trimesh import Trimesh
from trimesh.creation import box, cylinder
from trimesh.util import concatenate

FOLDER = Path(__file__).resolve().parents[2] / "scenarios" / "meshes"
SECTIONS = 16


def block(x_m: tuple[float, float], y_m: tuple[float, float], z_m: tuple[float, float]) -> Trimesh:
    """Make a box.

    Parameters
    ----------
    x_m, y_m, z_m : (float, float)
        Its limits.

    Returns
    -------
    Trimesh
    """
    return box(bounds=np.array([x_m, y_m, z_m]).T)


def upright(x_m: float, y_m: float, z_m: tuple[float, float], radius_m: float) -> Trimesh:
    """Make a standing cylinder.

    Parameters
    ----------
    x_m, y_m : float
        Place of its axis.
    z_m : (float, float)
        Its lower and its upper end.
    radius_m : float

    Returns
    -------
    Trimesh
    """
    return cylinder(radius_m, sections=SECTIONS, segment=np.array([[x_m, y_m, z] for z in z_m]))


def wheel(x_m: tuple[float, float], y_m: float, radius_m: float) -> Trimesh:
    """Make a wheel on the ground, whose axle lies along x.

    Parameters
    ----------
    x_m : (float, float)
        Its two sides.
    y_m, radius_m : float

    Returns
    -------
    Trimesh
    """
    return cylinder(radius_m, sections=SECTIONS, segment=np.array([[x, y_m, radius_m] for x in x_m]))


def meshes() -> dict[str, Trimesh]:
    """Make all meshes; fronts of vehicles face +y, and everything stands on z = 0.

    Returns
    -------
    dict of str to Trimesh
        By the name of the file.
    """
    return {
        "house": concatenate(
            [
                block((-6, 6), (-4, 4), (0, 7)),
                block((-5, -4), (-1, 0), (7, 8.5)),  # chimney
                block((-1.5, 1.5), (4, 5.2), (3, 4)),  # balcony
            ]
        ),
        "tram": concatenate(
            [
                block((-1.2, 1.2), (-7, 7), (0.4, 3.4)),
                block((-0.8, 0.8), (-2, 2), (3.4, 3.8)),  # on the roof
            ]
        ),
        "car": concatenate(
            [
                block((-0.9, 0.9), (-2.2, 2.2), (0.3, 0.9)),
                block((-0.8, 0.8), (-1.3, 1.0), (0.9, 1.5)),
                *(wheel((x, x + 0.2), y, 0.3) for x in (-0.9, 0.7) for y in (-1.4, 1.4)),
            ]
        ),
        "shelter": concatenate(
            [
                block((-2, 2), (-0.7, 0.7), (2.4, 2.5)),
                block((-2, 2), (-0.7, -0.65), (0.2, 2.4)),
                *(upright(x, 0.6, (0, 2.4), 0.05) for x in (-1.9, 1.9)),
            ]
        ),
        "lamp": concatenate([upright(0, 0, (0, 7), 0.1), block((-0.2, 0.2), (-0.2, 1.2), (7, 7.2))]),
    }


def main() -> None:
    """Write the files."""
    FOLDER.mkdir(exist_ok=True)
    for name, mesh in meshes().items():
        (FOLDER / f"{name}.ply").write_bytes(mesh.export(file_type="ply", encoding="ascii"))


if __name__ == "__main__":
    main()
