"""The 4-D point cloud: what a scene holds and what an estimator returns."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from isacbench.checked_arrays import Floats, checked_array, freeze_arrays, named_columns, unmasked_array
from isacbench.display import Description, Displayed, range_text
from isacbench.errors import InputError
from isacbench.files.escaping import plural
from isacbench.model.cloud_files.point_files import read_point_table, write_point_table
from isacbench.model.cloud_files.tables import POINT_COLUMNS

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False, repr=False, init=False)
class PointCloud(Displayed):
    """Points with a radial velocity and a power.

    Attributes
    ----------
    xyz : ndarray of float64, shape (n, 3)
        Positions in metres.
    velocity : ndarray of float64, shape (n,)
        Radial velocities in m/s, positive when approaching. None makes them
        unknown: they are NaN, and scores that need them as well.
    power : ndarray of float64, shape (n,)
        Echo power |G|² relative to a unit scatterer; None makes it 1.

    Raises
    ------
    ValueError
        If the shapes disagree or a value is not finite.
    InputError
        If values are masked or no real numbers.

    Examples
    --------
    >>> cloud = PointCloud(xyz=[[1, 2, 3]], velocity=[4], power=[1])
    >>> len(cloud)
    1
    >>> cloud
    PointCloud: 1 point
      x 1 m; y 2 m; z 3 m; velocity 4 m/s; power 1
    """

    xyz: Floats
    velocity: Floats
    power: Floats

    def __init__(
        self, xyz: ArrayLike, velocity: ArrayLike | None = None, power: ArrayLike | None = None
    ) -> None:
        object.__setattr__(self, "xyz", xyz)
        freeze_arrays(self, "xyz")
        each = self.xyz.shape[:1]
        object.__setattr__(self, "velocity", np.full(each, np.nan) if velocity is None else velocity)
        object.__setattr__(self, "power", np.ones(each) if power is None else power)
        freeze_arrays(self, "velocity", "power")
        n = self.velocity.size
        if self.xyz.shape != (n, 3) or self.velocity.shape != (n,) or self.power.shape != (n,):
            raise ValueError(
                f"a point cloud takes xyz (n, 3), velocity (n,) and power (n,), "
                f"not {self.xyz.shape}, {self.velocity.shape} and {self.power.shape}"
            )
        for name in ("xyz", "power") if velocity is None else ("xyz", "velocity", "power"):
            if not np.isfinite(getattr(self, name)).all():
                raise ValueError(f"a point cloud takes finite values; {name} has NaN or infinity")

    def __len__(self) -> int:
        return self.velocity.size

    @property
    def has_velocity(self) -> bool:
        """False if the velocities are unknown; True for a cloud without points."""
        return not np.isnan(self.velocity).any()

    def _description(self) -> Description:
        return describe_points("PointCloud", self.xyz, self.velocity, power=self.power)

    @classmethod
    def empty(cls) -> PointCloud:
        """Return a cloud without points."""
        return cls(xyz=np.empty((0, 3)), velocity=np.empty(0), power=np.empty(0))

    @classmethod
    def from_array(cls, array: ArrayLike) -> PointCloud:
        """Build a cloud from x, y, z and perhaps v and power of its points.

        Parameters
        ----------
        array : array_like, shape (n, 3), (n, 4) or (n, 5), or table
            Columns x, y, z, v and power; without v it is unknown, without power it is 1.
            Columns of a table, such as a DataFrame, are found by their names (v may
            be called velocity), and others than these are refused.

        Raises
        ------
        ValueError
            If it has another shape.
        InputError
            If numbers are masked or not real, or columns are missing or unknown.
        """
        columns = named_columns(array)
        if columns is None:
            array = checked_array("a point array", array)
            if array.ndim != 2 or array.shape[1] not in (3, 4, 5):
                raise ValueError(f"a point array takes shape (n, 3), (n, 4) or (n, 5), not {array.shape}")
            found = dict(zip(POINT_COLUMNS, array.T, strict=False))
        else:
            found = _point_columns(columns)
        return cls(np.column_stack([found[name] for name in "xyz"]), found.get("v"), found.get("power"))

    @classmethod
    def read(cls, path: str | Path) -> PointCloud:
        """Read a csv, npy, npz, mat or ply file.

        Parameters
        ----------
        path : str or Path
            See `isacbench.model.cloud_files.point_files.read_point_table`.
        """
        columns: Any = read_point_table(path)
        return cls.from_array(columns)

    def write(self, path: str | Path) -> None:
        """Write a csv, npy, npz, mat or ply file.

        Parameters
        ----------
        path : str or Path
            See `isacbench.model.cloud_files.point_files.write_point_table`.
        """
        write_point_table(self._columns(), path)

    def _columns(self) -> dict[str, Floats]:
        """Columns of a table by their names, v only if it is known."""
        columns = dict(zip(POINT_COLUMNS, self.to_array().T, strict=True))
        return {name: column for name, column in columns.items() if name != "v" or self.has_velocity}

    def to_array(self) -> Floats:
        """Return the (n, 5) array of x, y, z, v and power; v is NaN if it is unknown."""
        return np.column_stack([self.xyz, self.velocity, self.power])

    def to_dataframe(self) -> pd.DataFrame:
        """Return a table with the columns of a csv file: x, y, z in m, v in m/s if it is known, and power.

        Examples
        --------
        >>> PointCloud(xyz=[[1, 2, 3]], velocity=[4], power=[1]).to_dataframe()
             x    y    z    v  power
        0  1.0  2.0  3.0  4.0    1.0
        """
        import pandas as pd  # which takes longer to load than all that this module needs

        return pd.DataFrame(self._columns())

    def select(self, keep: ArrayLike) -> PointCloud:
        """Select points.

        Parameters
        ----------
        keep : array_like of bool, shape (n,), or of int
            Which points, or their indices.
        """
        keep = unmasked_array("keep", keep)
        if keep.dtype != np.bool_:
            keep = checked_array("keep", keep, np.int64)
        velocity = self.velocity[keep] if self.has_velocity else None
        return PointCloud(self.xyz[keep], velocity, self.power[keep])


def _point_columns(columns: dict[str, ArrayLike]) -> dict[str, Floats]:
    """Columns of a table by their names in `POINT_COLUMNS`."""
    names = ["v" if name == "velocity" else name for name in columns]
    wanted = [name for name in POINT_COLUMNS if name in ("x", "y", "z") or name in names]
    if sorted(names) != sorted(wanted):
        found = ", ".join(columns)
        raise InputError(f"a table of points takes columns x, y, z, v if it is known and power, not {found}")
    values = dict(zip(names, columns.values(), strict=True))
    arrays = {name: checked_array(name, values[name]) for name in wanted}
    shapes = {name: array.shape for name, array in arrays.items()}
    if len({*shapes.values()}) > 1 or len(shapes["x"]) > 1:
        found = ", ".join(f"{name} {shape}" for name, shape in shapes.items())
        raise InputError(f"columns of points take one number a point, as many in each, not shapes {found}")
    return arrays


def describe_points(name: str, xyz: Floats, velocity: Floats, **others: Floats) -> Description:
    """Describe points by their number and the spans of their coordinates, velocities and other values.

    Parameters
    ----------
    name : str
        Type of the object.
    xyz : ndarray of float64, shape (n, 3)
    velocity : ndarray of float64, shape (n,)
    **others : ndarray of float64
        Further values by name.
    """
    title = f"{name}: {plural(len(velocity), 'point')}"
    if not len(velocity):
        return Description(title, {})
    places = {axis: range_text(values, "m") for axis, values in zip("xyz", xyz.T, strict=True)}
    speeds = "unknown" if np.isnan(velocity).all() else range_text(velocity, "m/s")
    spans = {other: range_text(values) for other, values in others.items()}
    return Description(title, {**places, "velocity": speeds, **spans})
