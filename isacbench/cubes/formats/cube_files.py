"""What all file formats of cubes have in common: checks, and which of several arrays is meant."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple

from isacbench.cubes.cube import describe_array
from isacbench.errors import InputError
from isacbench.files.checked_files import require_file
from isacbench.files.escaping import shortened

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from isacbench.cubes.cube import ComplexArray
    from isacbench.files.arrays.listing import Listed


class Role(NamedTuple):
    """What an array of a file is for.

    Attributes
    ----------
    name : str
        The array's name in files that hold several.
    axes : int
        By their number it is known under any other name, if it is the only one.
    """

    name: str
    axes: int


CUBE = Role("cube", 4)
GRID = Role("transmitted", 2)


def choose(path: Path, arrays: Mapping[str, Listed], role: Role) -> str:
    """Name of the array that has a role: the one of that name, else the only one of that many axes.

    Raises
    ------
    InputError
        Listing all arrays, if there is none or more than one.
    """
    if role.name in arrays:
        return role.name
    fitting = [name for name, array in arrays.items() if len(array.shape) == role.axes]
    if len(fitting) == 1:
        return fitting[0]
    found = ", ".join(f"{name} ({describe_array(*array)})" for name, array in arrays.items())
    raise InputError(
        f"{path}: wanted is an array named {role.name!r}, or just one of {role.axes} axes; "
        f"it holds {found or 'no arrays'}"
    )


def grid_beside(
    path: Path,
    arrays: Mapping[str, Listed],
    shape: tuple[int, ...],
    read: Callable[[str], ComplexArray],
) -> ComplexArray | None:
    """Read the transmitted grid beside a cube: the array of that name, None where there is none.

    Parameters
    ----------
    path : Path
    arrays : mapping of str to Listed
    shape : tuple of int
        Of the cube.
    read : callable
        Reads a grid by its name.

    Raises
    ------
    InputError
        If the grid has other subcarriers or symbols than the cube.
    """
    if GRID.name not in arrays:
        return None
    grid = read(GRID.name)
    if grid.shape != shape[:2]:
        raise InputError(
            f"{path}: {GRID.name} has shape {grid.shape}; the cube beside it takes {shape[:2]}: "
            "(subcarriers, symbols)"
        )
    return grid


@contextmanager
def parsing(path: Path, kind: str) -> Iterator[None]:
    """Name the file and its kind in whatever the parser of a format raises."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # Damaged files surface as anything that a parser can raise.
        raise InputError(f"{path}: cannot be read as {kind}: {shortened(str(error))}") from error


def require_size(path: Path, wanted: int, what: str) -> None:
    """Refuse a file that ends before its header says.

    Parameters
    ----------
    path : Path
    wanted : int
        Bytes that the header announces.
    what : str
        The array, in words.
    """
    size = require_file(path)
    if size < wanted:
        raise InputError(f"{path}: is truncated: {what} takes {wanted} bytes, the file has {size}")
