"""Recorded cubes as a sum of tiles, loaded one at a time."""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations
from math import prod
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from isacbench.errors import InputError
from isacbench.files.checked_files import GRID_BYTES, binary_size

if TYPE_CHECKING:
    from collections.abc import Iterator

    from isacbench.model.array import VirtualArray
    from isacbench.model.numerology import System

ComplexArray: TypeAlias = NDArray[np.complexfloating[Any, Any]]

TILE_BYTES = 32 * 2**20
"""Memory that a tile touches, unless told otherwise: 64 subcarriers at the paper's size in complex64."""

AXES = "(subcarriers, symbols, P, Q)"


class Tile(NamedTuple):
    """A part of a cube, loaded when it is asked for.

    Attributes
    ----------
    subcarriers, symbols : slice
        What it covers, with explicit bounds and step 1.
    elements : ndarray of intp, shape (e,)
        Array elements it covers, as indices into the requested list.
    load : callable
        Returns the values, complex of the cube's precision and native byte
        order, shape (subcarriers, symbols, e), in any strides. The array may
        be a view or a mapped file and must not be written to. May be called
        from any thread, in any order and again; what it took is released with
        the array that it returned.
    """

    subcarriers: slice
    symbols: slice
    elements: NDArray[np.intp]
    load: Callable[[], ComplexArray]


class Cube(Protocol):
    """A recorded frame: one complex number for every subcarrier, symbol and array element.

    Attributes
    ----------
    name : str
        What messages call it: its file, and the array in it.
    shape : (int, int, int, int)
        Subcarriers N, symbols M, elements P along u and Q along w.
    dtype : dtype
        complex64 or complex128, native byte order.
    transmitted : ndarray of complex, shape (N, M), or None
        Transmitted grid that the same file holds.

    See Also
    --------
    isacbench.cubes.opening.open_cube
    """

    name: str
    shape: tuple[int, int, int, int]
    dtype: np.dtype[Any]
    transmitted: ComplexArray | None

    def tiles(self, elements: NDArray[np.intp]) -> Iterator[Tile]:
        """Cut the cube of some elements into tiles.

        The cube is linear in what follows, so tiles need not be disjoint: the
        values of an element are the *sum* of the tiles that cover it. (They
        are disjoint but for compressed MATLAB files, which hold all real parts
        before the first imaginary part.)

        Parameters
        ----------
        elements : ndarray of int, shape (e, 2)
            Indices (p, q) of the elements that are needed.

        Yields
        ------
        Tile

        Raises
        ------
        InputError
            If an element lies outside the array.
        """

    def close(self) -> None:
        """Close the files that were opened for this cube; no tile may be loaded after."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def describe_array(shape: tuple[int, ...], dtype: np.dtype[Any]) -> str:
    """Words for an array in messages.

    Examples
    --------
    >>> describe_array((3, 4), np.dtype("c8"))
    'complex64 of shape (3, 4)'
    """
    return f"{dtype.newbyteorder('=')} of shape {shape}"


def is_complex(dtype: np.dtype[Any]) -> bool:
    """Whether a type is complex64 or complex128, in any byte order."""
    return dtype.kind == "c" and dtype.itemsize in (8, 16)


def require_cube(name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> tuple[int, int, int, int]:
    """Refuse an array that is no cube.

    Parameters
    ----------
    name : str
        What the message calls it.
    shape : tuple of int
    dtype : dtype

    Returns
    -------
    (int, int, int, int)
        The shape.

    Raises
    ------
    InputError
        If the numbers are not complex64 or complex128, the axes not four, or
        one of them empty.
    """
    if not is_complex(dtype):
        raise InputError(f"{name}: holds {_kind(dtype)}; a cube takes complex64 or complex128")
    if len(shape) != 4:
        raise InputError(f"{name}: has {_axes(len(shape))}, shape {shape}; a cube takes four: {AXES}")
    if min(shape) < 0:
        raise InputError(f"{name}: has shape {shape}; no axis of a cube is negative")
    if 0 in shape:
        raise InputError(f"{name}: is empty, shape {shape}; a cube takes at least one of {AXES} each")
    n_subcarriers, n_symbols, n_p, n_q = (int(length) for length in shape)
    return n_subcarriers, n_symbols, n_p, n_q


def require_grid(name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    """Refuse an array that is no transmitted grid.

    Parameters
    ----------
    name : str
        What the message calls it.
    shape : tuple of int
    dtype : dtype

    Raises
    ------
    InputError
        If it holds no numbers, the axes are not two, or one of them is empty,
        or it takes more than 256 MiB.
    """
    if not (is_complex(dtype) or dtype.kind in "iuf"):
        raise InputError(
            f"{name}: holds {_kind(dtype)}; a transmitted grid takes complex64, complex128 or real numbers"
        )
    if len(shape) != 2 or min(shape) < 1:
        raise InputError(
            f"{name}: has shape {shape}; a transmitted grid takes two axes: (subcarriers, symbols)"
        )
    takes = prod(shape) * np.dtype(np.complex128).itemsize
    if takes > GRID_BYTES:
        raise InputError(
            f"{name}: has shape {shape}, which takes {binary_size(takes)}; a transmitted grid takes at most "
            f"{binary_size(GRID_BYTES)}"
        )


def complex_grid(values: NDArray[Any]) -> ComplexArray:
    """Values of a transmitted grid in C order and native byte order; real ones become complex128."""
    dtype = values.dtype.newbyteorder("=") if values.dtype.kind == "c" else np.dtype(np.complex128)
    return np.ascontiguousarray(values, dtype=dtype)


def require_elements(cube: Cube, elements: NDArray[np.intp]) -> None:
    """Refuse elements (e, 2) that the array of a cube does not have.

    Raises
    ------
    InputError
        Naming the first of them.
    """
    outside = ((elements < 0) | (elements >= cube.shape[2:])).any(axis=1)
    if outside.any():
        p, q = elements[outside.argmax()].tolist()
        raise InputError(f"{cube.name}: has no element ({p}, {q}); its array is {cube.shape[2:]}")


def require_shape(cube: Cube, system: System, array: VirtualArray) -> None:
    """Refuse a cube that does not fit the radio of a scenario.

    Parameters
    ----------
    cube : Cube
    system : System
        Its numbers of subcarriers and symbols are asked for,
    array : VirtualArray
        and its elements along u and along w.

    Raises
    ------
    InputError
        If the shape is another, saying so when the axes look permuted.
    """
    wanted = (system.n_subcarriers, system.n_symbols, *array.shape)
    if cube.shape != wanted:
        raise InputError(
            f"{cube.name}: has shape {cube.shape}; the scenario takes {wanted}: {AXES}"
            f"{_permuted(cube.shape, wanted)}"
        )


def _permuted(shape: tuple[int, ...], wanted: tuple[int, ...]) -> str:
    """Say how the axes of a shape have to be permuted to give another; nothing where they cannot."""
    fitting = [axes for axes in permutations(range(4)) if tuple(shape[axis] for axis in axes) == wanted]
    if not fitting:
        return ""
    return f". The axes look permuted: numpy.transpose with axes {' or '.join(map(str, fitting))} would fit"


def _axes(count: int) -> str:
    """A number of axes in words."""
    return "1 axis" if count == 1 else f"{count} axes"


def _kind(dtype: np.dtype[Any]) -> str:
    """What an array that is refused holds, in words."""
    if dtype.hasobject:
        return "Python objects, which are never unpickled"
    if dtype.kind == "c":
        return f"complex{8 * dtype.itemsize}"
    if dtype.kind == "f":
        return f"real numbers ({dtype.newbyteorder('=')})"
    if dtype.kind in "iu":
        return f"integers ({dtype.newbyteorder('=')})"
    if dtype.names is not None:
        return f"records of {', '.join(f'{name} ({dtype[name]})' for name in dtype.names)}"
    return f"no numbers ({dtype})"
